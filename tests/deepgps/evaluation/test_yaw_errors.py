import numpy as np
import pytest

from deepgps.evaluation.error_field import ErrorField
from deepgps.evaluation.measures import summarise_yaw

HEADING = np.radians([0.0, 90.0, 180.0, -90.0])
ERROR_DEG = np.array([[1.0, -1.0, 1.0, np.nan], [2.0, -2.0, 2.0, -20.0]])


def make_field(accepted: np.ndarray | None) -> ErrorField:
    place = np.zeros((2, 2))
    yaw = HEADING + np.radians(ERROR_DEG) + 2.0 * np.pi
    return ErrorField(place, HEADING, np.zeros((2, 4, 2)), accepted=accepted, yaw=yaw)


def test_what_is_refused_counts_in_the_rms_of_all_alone():
    accepted = np.array([[True, True, True, True], [True, True, True, False]])
    figures = summarise_yaw(make_field(accepted))
    assert figures["yaw_rms_deg"] == pytest.approx(np.sqrt((3 + 12 + 400) / 7))
    assert figures["yaw_rms_accepted_deg"] == pytest.approx(np.sqrt((3 + 12) / 6))
    assert figures["yaw_median_deg"] == pytest.approx(2.0)


def test_a_method_that_refuses_nothing_has_no_figure_of_what_it_accepts():
    assert "yaw_rms_accepted_deg" not in summarise_yaw(make_field(None))
    assert "yaw_rms_accepted_deg" not in summarise_yaw(make_field(np.zeros((2, 4), bool)))
