"""A run's recording: whole, read back as it was written, and one clear line where something is missing."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from scipy.spatial.distance import pdist

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import read_all_headings, split_by_acceptance
from deepgps.runs.run_folder import VIEWED
from deepgps.viewer import drive
from deepgps.viewer import run as recording
from deepgps.viewer.drive import ROBOT
from deepgps.viewer.error_field import ACCEPTED_PART, REFUSED_PART, TRUST
from deepgps.viewer.places import PICTURES, Place, find_places, turn_picture
from deepgps.viewer.run import find_recording, write_run
from deepgps.viewer.show import view
from deepgps.viewer.stream import DRIVE_TIME, PLACE, STEP
from sim.errors import InputError, WorkError
from sim.recording.format import finish_recording, open_recording, read_manifest
from sim.sensors.camera.lens import make_lens, project_polar
from sim.settings import CameraSettings
from tests.helpers.blueprints import (
    call_rerun,
    count_rows,
    find_missing,
    read_entity,
    read_error_field,
    read_layout,
    read_static,
)
from tests.helpers.synthetic_run import REFUSING, write_synthetic_run

SAMPLES = 60


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_synthetic_run(tmp_path_factory.mktemp("run"), samples=SAMPLES, spacing_m=0.4)
    rr.set_strict_mode(True)
    write_run(folder)
    rr.set_strict_mode(False)
    return folder


@pytest.fixture
def copied(run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run, tmp_path / "copy"))


@pytest.fixture(scope="module")
def changed(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy with a long drive, a wrong track, and no training histories."""
    folder = Path(shutil.copytree(run, tmp_path_factory.mktemp("changed") / "copy"))
    path = folder / "recording" / "time.npy"
    np.save(path, 1000 * np.load(path))
    manifest = read_manifest(path.parent).model_dump(by_alias=True)
    manifest["odometry"]["track_m"] *= 1.1
    manifest["settings"]["encoder"] = {"track_error": 0.1}
    finish_recording(path.parent, manifest)
    for path in folder.glob("*/history.npz"):
        path.unlink()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drive, "MAX_IMAGES", 25)
        write_run(folder)
    return folder


def read_along(run: Path, entity: str, timeline: str) -> pa.Table:
    """The rows of an entity in the order of a timeline."""
    rows = read_entity(run / VIEWED, entity)
    return rows.filter(pc.field(timeline).is_valid()).sort_by(timeline)


def read_places(run: Path) -> list[Place]:
    return find_places(run, read_all_headings(run), open_recording(run / "recording"))


def test_error_fields_are_shown_as_they_were_measured(run: Path) -> None:
    for method, field in read_all_headings(run).items():
        for part, worst in zip((ACCEPTED_PART, REFUSED_PART), split_by_acceptance(field), strict=True):
            truth, predicted = read_error_field(run / VIEWED, method, parts=(part,))
            np.testing.assert_allclose(truth, worst.truth, atol=1e-6)
            np.testing.assert_allclose(predicted, worst.predicted, atol=1e-6)


def test_the_errors_of_each_snapshot_read_back(run: Path) -> None:
    """Arrows end at the snapshot's points but for a rigid motion, and shorten as the training goes on."""
    with np.load(run / "deepgps" / "history.npz") as history:
        index, snapshot = history["snapshot_index"], history["snapshot"]
    place = np.load(run / "recording" / "truth" / "pose.npy")[index, :2]
    rows = read_along(run, "world/training_error/deepgps", STEP)
    origins, vectors = (np.array(rows[f"Arrows3D:{part}"].to_pylist())[..., :2] for part in ("origins", "vectors"))
    np.testing.assert_allclose(origins, np.broadcast_to(place, origins.shape), atol=1e-6)
    for points, ends in zip(snapshot, origins + vectors, strict=True):
        np.testing.assert_allclose(pdist(ends), pdist(points), atol=1e-4)
    length = np.linalg.norm(vectors, axis=2).mean(axis=1)
    assert length[-1] < 0.2 * length[0]


def test_only_snapshots_of_deepgps_are_turned_over(run: Path) -> None:
    """All the made-up histories are mirrored; tables forgive that to DeepGPS alone."""
    for method, hand in (("deepgps", -1), ("posenet", 1), ("dead_reckoned_labels", 1)):
        with np.load(run / method / "history.npz") as history:
            before = history["snapshot"][-1]
        rows = read_along(run, f"world/training/{method}", STEP)
        after = np.array(rows["Points3D:positions"].to_pylist()[-1])[:, :2]
        turn = np.linalg.lstsq(before - before.mean(axis=0), after - after.mean(axis=0))[0]
        assert np.linalg.det(turn) == pytest.approx(hand, abs=1e-3)


def test_drive_and_training_are_there_row_by_row(run: Path) -> None:
    counts, readings = count_rows(run / VIEWED), len(np.load(run / "recording" / "reading.npy"))
    expected = dict.fromkeys(["/drive/fisheye", "/drive/polar", f"/{ROBOT}"], SAMPLES)
    for path in (
        "drive/segment_error",
        *("world/reckoned/place", "world/reckoned/drift", "world/reckoned/leg", "encoders/drift"),
    ):
        expected[f"/{path}"] = readings
    for name in ("deepgps", "posenet", "dead_reckoned_labels"):
        with np.load(run / name / "history.npz") as history:
            expected[f"/training/{name}/loss"] = len(history["loss"])
            for path in (f"training/{name}", f"training_error/{name}", f"training_error/{name}/places"):
                expected[f"/world/{path}"] = len(history["snapshot"]) + 1  # the last also at the start of the drive
    assert expected.items() <= counts.items()
    assert counts["/world/reckoned/path"] == counts["/world/drive/path"] > 0
    assert {"/encoders/faults", "/encoders/segments", "/report/figures", "/report/text"} <= set(counts)
    assert {"/world/room", "/world/floor_plan"} <= set(counts)


def test_ticks_are_counted_from_reading_to_reading_of_a_segment(run: Path) -> None:
    reading = np.load(run / "recording" / "reading.npy")
    rows = read_along(run, "drive/ticks/right", DRIVE_TIME)
    expected = [later[3] - before[3] for before, later in pairwise(reading) if before[0] == later[0]]
    np.testing.assert_array_equal(np.concatenate(rows["Scalars:scalars"].to_pylist()), expected)


def test_every_arrow_and_dot_says_its_error_in_the_tooltip(run: Path) -> None:
    """The viewer lists at most three components that differ from arrow to arrow."""
    places = read_places(run)
    for method in ("posenet", "knn"):
        marks = {one.at[0]: f", place {k}" for k, one in enumerate(places, 1) if one.method == method}
        assert len(marks) > 1
        accepted, refused = split_by_acceptance(read_all_headings(run)[method])
        assert (len(refused.error) > 0) == (method in REFUSING)
        for part, field, before in ((ACCEPTED_PART, accepted, ""), (REFUSED_PART, refused, "refused: ")):
            radii = field.error if field.radius is None else field.radius
            expected = [
                f"{before}{100 * error:.1f}{'' if field.radius is None else f' (± {100 * radius:.1f})'} cm, "
                f"{round(np.degrees(heading)) % 360}° → {x:z.2f}, {y:z.2f}{marks.get(cell, '')}"
                for error, radius, heading, (x, y), (cell, _) in zip(
                    field.error, radii, field.heading, field.predicted, np.asarray(field.row).tolist(), strict=True
                )
            ]
            for shape, position in (("arrows", "LineStrips3D:strips"), ("places", "Points3D:positions")):
                rows = read_entity(run / VIEWED, f"world/error_field/{method}/{part}/{shape}")
                values = {name: rows[name].combine_chunks().flatten() for name in rows.column_names}
                assert values["error"].to_pylist() == expected and len(values[position]) == len(expected)
                assert values["method"].to_pylist() == [title_of(method)]
                assert sum(len(column) > 1 for column in values.values()) <= 3


def test_numbers_of_metres_stand_where_they_say(run: Path) -> None:
    labels, places = (read_static(run / VIEWED, "world/metres", f"Points3D:{one}") for one in ("labels", "positions"))
    number = np.array([float(one.removesuffix(" m")) for one in labels])
    off = np.abs(np.array(places)[:, :2] - number[:, None])
    assert len(number) > 8 and off.min(axis=1).max() < 0.11  # along x or y; the latter stand a little higher


def test_places_begin_with_the_worst_of_the_first_method_which_the_drive_shows(run: Path) -> None:
    places = read_places(run)
    texts = ["".join(text) for text in read_along(run, "place/text", PLACE)["TextDocument:text"].to_pylist()]
    for place, text in zip(places, texts, strict=True):
        error = 100 * place.field.error[place.at]
        assert text.startswith(f"# {title_of(place.method)}: {error:.1f} cm")
        if place.rank.startswith("Worst place 1 "):
            assert error == pytest.approx(100 * place.field.error.max())
    assert read_along(run, "place/text", PLACE)[PLACE].to_pylist() == list(range(1, len(places) + 1))
    (shown,) = read_along(run, "place/text", DRIVE_TIME)["TextDocument:text"].to_pylist()
    assert shown == [texts[0]]
    counts = count_rows(run / VIEWED)
    for name in PICTURES:
        assert counts[f"/place/{name}"] == counts["/world/place/error"] == len(places) + 1


def test_a_picture_turned_to_another_heading_is_as_the_camera_sees_there() -> None:
    """A point in the room at one azimuth: the camera sees it at that azimuth minus its own heading."""
    rings, sectors, point = 8, 64, np.radians(70.0)

    def see(yaw: float) -> np.ndarray:
        azimuth = point - yaw
        direction = np.array([np.cos(azimuth), np.sin(azimuth), 0.3])
        row, column = project_polar(make_lens(CameraSettings()), direction, rings, sectors)
        picture = np.zeros((rings, sectors, 3), np.uint8)
        picture[round(float(row)), round(float(column)) % sectors] = 255
        return picture

    sector = 2 * np.pi / sectors
    for here, there in ((0.0, 5.0), (3.0, -40.0), (60.0, 7.0)):
        turned = turn_picture(see(here * sector), (here - there) * sector)
        np.testing.assert_array_equal(turned, see(there * sector))


def test_worst_places_are_apart_and_in_order(run: Path) -> None:
    places = read_places(run)
    for method, field in read_all_headings(run).items():
        cells = [place.at[0] for place in places if place.method == method]
        assert (np.diff(field.error[cells].max(axis=1)) <= 0).all()
        assert pdist(field.truth[cells]).min() > 0.25


def test_radii_are_the_largest_of_what_is_accepted(run: Path) -> None:
    (method, field) = next(iter(read_all_headings(run).items()))
    largest = 100 * np.where(field.is_accepted, np.asarray(field.radius), 0).max(axis=1)
    expected = [f"68 % within {one:.1f} cm" if one else "refused at all headings" for one in largest]
    assert read_static(run / VIEWED, f"{TRUST}/{method}/radius", "radius") == expected and 0 in largest


def test_a_worst_place_shows_its_radii_and_says_whether_it_was_refused(run: Path) -> None:
    places = read_places(run)
    shown = {"place/text": "TextDocument:text", "world/place/label": "Points3D:labels"}
    shown["world/place/radius"] = "LineStrips3D:strips"
    texts, labels, circles = (read_along(run, path, PLACE)[name].to_pylist() for path, name in shown.items())
    assert len(texts) == len(circles) == len(places)
    for (text,), drawn, (label,), place in zip(texts, circles, labels, places, strict=True):
        field, at = place.field, place.at
        told = place.method in REFUSING and field.is_accepted[at]
        assert len(drawn) == (2 if told else 0)
        assert ("The method refuses this image" in text) == label.endswith("refused") == (not field.is_accepted[at])
        assert ("The method accepts this image." in text) == told
        assert (f"within {100 * np.asarray(field.radius)[at]:.1f} cm (68 %)" in text) if told else "68 %" not in text


def test_the_recording_is_whole_without_wall_clock(run: Path) -> None:
    path = run / VIEWED
    call_rerun("verify", path)
    names = {name for chunk in RrdReader(path).stream() for name in chunk.timeline_names}
    assert names == {DRIVE_TIME, STEP, PLACE}
    assert find_missing(path) == []


def test_a_long_drive_has_fewer_pictures(changed: Path) -> None:
    counts = count_rows(changed / VIEWED)
    assert counts["/drive/fisheye"] == counts["/drive/polar"] == 20  # every third of 60
    assert counts[f"/{ROBOT}"] == SAMPLES
    assert find_missing(changed / VIEWED) == []


def test_the_robot_is_as_large_as_it_is_and_not_as_odometry_has_it(run: Path, changed: Path) -> None:
    radii = [read_static(folder / VIEWED, f"{ROBOT}/body", "Cylinders3D:radii") for folder in (run, changed)]
    np.testing.assert_allclose(*radii)  # pyright: ignore


def test_the_slider_has_the_seconds_of_the_drive_and_is_played_in_a_hundred(changed: Path) -> None:
    time_s = np.load(changed / "recording" / "time.npy")
    at = read_along(changed, ROBOT, DRIVE_TIME)[DRIVE_TIME].to_numpy().astype(float) / 1e9
    assert (at[0], at[-1]) == pytest.approx((time_s[0], time_s[-1]), abs=1.0) and np.ptp(time_s) > 3600
    places = read_along(changed, "place/text", DRIVE_TIME)[DRIVE_TIME].to_numpy().astype(float) / 1e9
    assert places.tolist() == [pytest.approx(time_s[0], abs=1.0)]
    ((_, (speed,)),) = read_layout(changed / VIEWED, "TimePanelBlueprint:playback_speed")
    assert np.ptp(time_s) / speed == pytest.approx(100.0)
    ranges = [one["range"] for _, some in read_layout(changed / VIEWED, "VisibleTimeRanges:ranges") for one in some]
    assert {one["start"] / 1e9 for one in ranges if one["start"] is not None} == {-60, -120}


def test_a_missing_or_damaged_recording_is_made_again_the_same(
    run: Path, copied: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = copied / VIEWED
    content = path.read_bytes()
    path.write_bytes(content[:-7] + b"x" + content[-6:])
    assert find_recording(copied) == path
    assert f"{path} is damaged" in caplog.text
    assert len({RrdReader(one).recordings()[0].recording_id for one in (run / VIEWED, path)}) == 1
    call_rerun("compare", "--unordered", run / VIEWED, path)
    path.unlink()
    monkeypatch.setattr(recording, "write_run", lambda folder: ("written", folder))
    assert find_recording(copied) == ("written", copied)


def test_a_folder_that_is_no_run_or_half_a_run_is_refused_and_left_alone(copied: Path, tmp_path: Path) -> None:
    (copied / VIEWED).unlink()
    (copied / "recording" / "scene.glb").write_bytes(b"half")
    for folder, message in ((tmp_path, r"metrics\.json"), (copied, r"scene.glb is damaged")):
        with pytest.raises(InputError, match=message):
            view([folder])
    assert not (copied / VIEWED).exists()


def test_no_display_and_no_viewer_are_one_clear_line_each(
    run: Path, without_display: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(WorkError, match="without a display, copy") as caught:
        view([run])
    assert "\n" not in str(caught.value)
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr(rr, "__file__", "/nonexistent/rerun/__init__.py")
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(WorkError, match="the Rerun viewer is missing"):
        view([run])
