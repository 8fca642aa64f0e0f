"""Images that are looked at, on a real recording of a small room of which a part of every test image is hidden."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest
import rerun.blueprint as rrb

from deepgps.evaluation.error_field import ErrorField
from deepgps.evaluation.evaluate import measure_field, predict
from deepgps.evaluation.stored_alignment import write_alignment
from deepgps.learning.training_data import prepare
from deepgps.positioner.kriging import NEIGHBOURS
from deepgps.positioner.stored_positioner import save_positioner
from deepgps.viewer import places as viewer
from deepgps.viewer.places import find_places, log_places, mark_pixels
from deepgps.viewer.stream import PLACE, save_recording
from sim.alignment import Alignment
from sim.recording.format import Recording, open_recording, open_truth
from tests.deepgps.positioner.test_registration import SETTINGS, place
from tests.helpers.blueprints import read_entity

METHOD, HIDDEN_SECTORS = "registration", slice(5, 9)
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


def test_an_image_is_shown_with_its_modes_what_differs_and_the_images_that_it_is_compared_with(
    run: Run, tmp_path: Path
) -> None:
    recording = run[2]
    path, everything, truth = tmp_path / "places.rrd", find_places(*run), open_truth(recording.folder)
    save_recording(path, "0" * 32, "", rrb.Blueprint(), lambda stream: log_places(stream, everything, recording, truth))
    columns = []
    for name in ("modes", "near"):
        rows = read_entity(path, f"world/place/{name}")
        rows = rows.filter(pc.field(PLACE).is_valid()).sort_by(PLACE)["Points3D:positions"]
        columns.append([np.reshape(row, (-1, 3))[:, :2] for row in rows.drop_null().to_pylist()])
    shown = [row for row in zip(everything, *columns, strict=True) if row[0].method == METHOD]
    assert len(shown) == viewer.OTHERS
    for one, modes, near in shown:
        assert one.look is not None
        np.testing.assert_allclose(modes, one.look.mode[: len(modes)], atol=1e-6)
        np.testing.assert_allclose(modes[0], one.field.predicted[one.at], atol=1e-6)
        away = np.linalg.norm(truth.pose[:, :2] - modes[0], axis=1)  # the map is true but for its frame
        np.testing.assert_allclose(np.linalg.norm(near - modes[0], axis=1), np.sort(away)[:NEIGHBOURS], atol=1e-3)
    marked = np.array([mark_pixels(one.image, one.look and one.look.weight) for one, _, _ in shown])
    red = marked[..., 0] - marked[..., 1].astype(float)
    assert red[:, :, HIDDEN_SECTORS].mean() > 2.0 * red.mean()


def test_nothing_is_said_of_a_method_that_does_not_say_why_or_is_gone(
    run: Run,
) -> None:
    folder, fields, recording = run
    silent, trusting = (replace(fields[METHOD], **{name: None}) for name in ("reason", "accepted"))
    for where, field, told in (
        (folder, silent, False),
        (folder, trusting, True),
        (folder / "gone", fields[METHOD], False),
    ):
        places = find_places(where, {METHOD: field}, recording)
        assert all((one.look is not None) == told for one in places)
