"""Images that a method refuses, on a real recording of a small room of which a part of every test image is hidden."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb
from scipy.spatial.distance import pdist

from deepgps.evaluation.error_field import ErrorField
from deepgps.evaluation.evaluate import measure_field, predict
from deepgps.evaluation.stored_alignment import write_alignment
from deepgps.learning.training_data import prepare
from deepgps.positioner.stored_positioner import save_positioner
from deepgps.viewer.places import MIN_SEPARATION_M
from deepgps.viewer.read import read_entity
from deepgps.viewer.refused import DIFFERENCES, DOUBTS, WORDS, find_refused, log_refused, mark_pixels
from deepgps.viewer.stream import REFUSED_IMAGE, save_recording
from sim.alignment import Alignment
from sim.recording.format import Recording, open_recording, open_truth
from tests.deepgps.positioner.test_registration import SETTINGS, place

METHOD = "registration"
HIDDEN_SECTORS = slice(5, 9)
Run = tuple[Path, dict[str, ErrorField], Recording]


@pytest.fixture(scope="module")
def run(small_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run with registration on a map that is turned against the world, and test images of which a part is hidden."""
    recording, truth = open_recording(small_recording), open_truth(small_recording)
    images, folder = np.array(recording.test_observation), tmp_path_factory.mktemp("refusing")
    images[..., HIDDEN_SECTORS, :] = 127
    recording = replace(recording, test_observation=images)
    turned = Alignment(np.array([[0.0, -1.0], [1.0, 0.0]]), np.ones(2), 1.0)
    data = prepare(recording, SETTINGS, 0, folder)
    positioner = place(data, turned.apply(truth.pose[:, :2]), turned.turn(truth.pose[:, 2]))
    save_positioner(folder / METHOD, positioner, {})
    field, alignment = measure_field(predict(folder / METHOD, recording), METHOD, truth)
    write_alignment(folder / METHOD, alignment, "SE2")
    return folder, {"knn": replace(field, reason=None), METHOD: field}, recording


def test_the_most_unlike_come_first_then_the_most_doubtful_all_of_different_places(run: Run) -> None:
    refused = find_refused(*run)
    assert refused is not None and refused.method == METHOD
    found, count = refused.found, int((refused.found.reason != 2).sum())
    assert (found.reason > 0).all() and (found.reason[count:] == 2).all()
    assert 0 < count <= DIFFERENCES and 0 < len(found.reason) - count <= DOUBTS
    assert (np.diff(found.unlike[:count]) <= 0).all() and (np.diff(found.weight[count:, 1:].max(axis=1)) <= 0).all()
    assert min(pdist(part).min() for part in np.split(refused.pose[:, :2], [count])) > MIN_SEPARATION_M


def test_what_is_hidden_is_marked_and_the_best_mode_drawn_is_the_answer_in_the_world(run: Run, tmp_path: Path) -> None:
    path, refused = tmp_path / "refused.rrd", find_refused(*run)
    assert refused is not None and refused.weight is not None
    found, weight = refused.found, refused.weight
    red = np.diff(mark_pixels(refused.image, weight)[..., 1::-1].astype(float))
    assert weight[..., HIDDEN_SECTORS].mean() < 0.5 * weight.mean()
    assert red[:, :, HIDDEN_SECTORS].mean() > 2.0 * red.mean()
    np.testing.assert_allclose(np.linalg.norm(found.mode[:, 0] - refused.pose[:, :2], axis=1), refused.error, atol=1e-6)
    save_recording(path, "0" * 32, "refused", rrb.Blueprint(), lambda stream: log_refused(stream, refused, run[2]))
    names = ("world/refused/others", "refused/text", "refused/weight/polar")
    tables = (read_entity(path, name).sort_by([(REFUSED_IMAGE, "descending")]) for name in names)
    modes, texts, _ = (table.to_pylist()[: len(found.mode)] for table in tables)  # without what is static
    for row, text, mode, share, reason in zip(modes, texts, found.mode, found.weight, found.reason, strict=True):
        known = np.isfinite(mode[1:, 0])
        assert row["Points3D:labels"] == [f"{100 * one:.0f} %" for one in share[1:][known]]
        np.testing.assert_allclose(np.reshape(row["Points3D:positions"], (-1, 3))[:, :2], mode[1:][known], atol=1e-6)
        assert text["TextDocument:text"][0].startswith(f"# {WORDS[reason]}")


def test_nothing_is_shown_of_a_method_that_does_not_say_why_or_accepts_all_or_is_gone(run: Run) -> None:
    folder, fields, recording = run
    silent, trusting = (replace(fields[METHOD], **{name: None}) for name in ("reason", "accepted"))
    for where, field in ((folder, silent), (folder, trusting), (folder / "gone", fields[METHOD])):
        assert find_refused(where, {METHOD: field}, recording) is None
