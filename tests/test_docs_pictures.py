"""The pictures of the pages are drawn from runs by scripts, which must keep up with the code."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from deepgps.evaluation.error_field import read_all_headings
from docs import pictures
from docs.explore_picture import draw_drive
from docs.trust_picture import draw_trust
from sim.recording.format import open_truth


@pytest.mark.slow
def test_the_pictures_of_concepts_are_drawn_from_a_run(finished_run: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(pictures, "PICTURES", tmp_path)
    pictures.draw_all(finished_run)
    drawn = {path.stem: np.asarray(cv2.imread(str(path))) for path in tmp_path.glob("*.png")}
    assert set(drawn) == {"camera", "segments", "straightness", "map", "fold", "error_field"}
    assert all(picture.std() > 10 for picture in drawn.values())


def test_the_picture_of_exploring_is_drawn_from_a_drive(finished_run: Path):
    assert len(draw_drive(open_truth(finished_run / "recording")).axes) == 3


def test_the_picture_about_trust_is_drawn_from_a_run(finished_run: Path):
    truth = open_truth(finished_run / "recording")
    figure = draw_trust(truth.free_space, read_all_headings(finished_run))
    assert len(figure.axes) == 3
