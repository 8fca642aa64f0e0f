"""The recording: whole, read back as it was written, and one clear line where something is missing."""

import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest
import rerun as rr
from rerun.chunk import RrdReader
from scipy.spatial.distance import pdist

from deepgps.config.methods import title_of
from deepgps.evaluation.error_field import read_all_headings, read_fields, split_by_acceptance
from deepgps.reports.run_report import describe
from deepgps.viewer.layers import COVERAGE, DENSITY
from deepgps.viewer.pictures import choose_views, write_pictures
from deepgps.viewer.read import read_entity, read_error_field, read_error_table
from deepgps.viewer.run import drive
from deepgps.viewer.run.drive import ROBOT
from deepgps.viewer.run.places import PICTURES, find_places, turn_picture
from deepgps.viewer.run.recording import RECORDING, find_recording, write_run
from deepgps.viewer.timeline import DRIVE_TIME, PLACE, PROGRESS, PROGRESS_END_S, STEP
from deepgps.viewer.window.connect import find_viewer
from deepgps.viewer.window.show import view
from sim.errors import InputError, WorkError
from sim.files.json_files import read_json, write_json
from sim.recording.format import finish_recording, read_manifest
from sim.sensors.camera.lens import make_lens, project_polar
from sim.settings import CameraSettings
from tests.helpers.blueprints import find_missing, read_layout
from tests.helpers.synthetic_run import METHODS, REFUSING, write_synthetic_run

SAMPLES = 60
ROOT = Path(__file__).parents[4]


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


def rows_by_entity(path: Path) -> dict[str, int]:
    """Rows of each entity over time; static ones count none."""
    counts: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        timed = set(chunk.to_record_batch().schema.names) & {DRIVE_TIME, STEP, PLACE}
        counts[chunk.entity_path] = counts.get(chunk.entity_path, 0) + (chunk.num_rows if timed else 0)
    return counts


@pytest.mark.parametrize("method", METHODS)
def test_the_error_field_reads_back_as_it_was_measured(run: Path, method: str) -> None:
    with np.load(run / "error_field.npz") as arrays:
        truth, predicted = arrays["truth"], arrays[method]
    error = np.linalg.norm(predicted - truth[:, None], axis=-1).max(axis=1)
    field = read_error_field(run / RECORDING, method)
    np.testing.assert_allclose(field.truth, truth, atol=1e-6)
    np.testing.assert_allclose(field.error, error, atol=1e-6)
    np.testing.assert_allclose(field.predicted, read_fields(run)[method].predicted, atol=1e-6)


def test_the_table_holds_all_error_fields(run: Path) -> None:
    table = read_error_table(run / RECORDING)
    assert table.column_names == ["x_m", "y_m", "predicted_x_m", "predicted_y_m", "error_m", "heading_deg", "method"]
    with np.load(run / "error_field.npz") as arrays:
        assert table.num_rows == len(METHODS) * len(arrays["truth"])
        for method in METHODS:
            rows = table.filter(pc.field("method") == method)
            truth, predicted = (np.column_stack([rows[f"{of}{axis}_m"] for axis in "xy"]) for of in ("", "predicted_"))
            error = np.linalg.norm(arrays[method] - arrays["truth"][:, None], axis=-1)
            worst = arrays[method][np.arange(len(error)), error.argmax(axis=1)]
            np.testing.assert_allclose(truth, arrays["truth"], atol=1e-6)
            np.testing.assert_allclose(predicted, worst, atol=1e-6)
            np.testing.assert_allclose(rows["error_m"], error.max(axis=1), atol=1e-6)


def test_the_table_of_a_root_that_is_not_there_is_refused(run: Path) -> None:
    with pytest.raises(InputError, match="has no error field below 'a'"):
        read_error_table(run / RECORDING, "a")


def test_the_examples_of_reading_back_work(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pages = [(ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "runs/README.md")]
    blocks = [block for page in pages for block in re.findall(r"```python\n(.*?)```", page, re.S)]
    examples = [block for block in blocks if "read_error_table" in block]
    assert examples
    for example in examples:
        code, found = re.subn(r'"runs/[^"]*run\.rrd"', repr(str(run / RECORDING)), example)
        assert found
        exec(code, {})
        assert capsys.readouterr().out


def test_the_errors_of_each_snapshot_read_back(run: Path) -> None:
    """Arrows end at the snapshot's points but for a rigid motion, and shorten as the training goes on."""
    with np.load(run / "deepgps" / "history.npz") as history:
        index, snapshot = history["snapshot_index"], history["snapshot"]
    place = np.load(run / "recording" / "truth" / "pose.npy")[index, :2]
    rows = read_entity(run / RECORDING, "world/training_error/deepgps")
    rows = rows.filter(pc.field("step").is_valid()).sort_by("step")
    origins, vectors = (np.array(rows[f"Arrows3D:{part}"].to_pylist())[..., :2] for part in ("origins", "vectors"))
    np.testing.assert_allclose(origins, np.broadcast_to(place, origins.shape), atol=1e-6)
    for points, ends in zip(snapshot, origins + vectors, strict=True):
        np.testing.assert_allclose(pdist(ends), pdist(points), atol=1e-4)
    length = np.linalg.norm(vectors, axis=2).mean(axis=1)
    assert length[-1] < 0.2 * length[0]


@pytest.mark.parametrize(("method", "hand"), [("deepgps", -1), ("posenet", 1), ("dead_reckoned_labels", 1)])
def test_only_snapshots_of_deepgps_are_turned_over(run: Path, method: str, hand: int) -> None:
    """All the made-up histories are mirrored; tables forgive that to DeepGPS alone."""
    with np.load(run / method / "history.npz") as history:
        before = history["snapshot"][-1]
    rows = read_entity(run / RECORDING, f"world/training/{method}")
    rows = rows.filter(pc.field("step").is_valid()).sort_by("step")
    after = np.array(rows["Points3D:positions"].to_pylist()[-1])[:, :2]
    turn = np.linalg.lstsq(before - before.mean(axis=0), after - after.mean(axis=0))[0]
    assert np.linalg.det(turn) == pytest.approx(hand, abs=1e-3)


def test_an_entity_that_is_not_there_is_told_with_those_that_are(run: Path) -> None:
    with pytest.raises(InputError, match=r"no entity 'drive/tick'; it has .*drive/ticks/left"):
        read_entity(run / RECORDING, "drive/tick")


def test_drive_and_training_are_there_row_by_row(run: Path) -> None:
    counts = rows_by_entity(run / RECORDING)
    readings = len(np.load(run / "recording" / "reading.npy"))
    for path in ("drive/distance/encoder", "drive/distance/truth", "drive/difference", "drive/segment_error"):
        assert counts[f"/{path}"] == readings
    for path in ("drive/fisheye", "drive/polar", ROBOT):
        assert counts[f"/{path}"] == SAMPLES
    for name in ("deepgps", "posenet", "dead_reckoned_labels"):
        with np.load(run / name / "history.npz") as history:
            assert counts[f"/training/{name}/loss"] == len(history["loss"])
            for path in (f"training/{name}", f"training_error/{name}", f"training_error/{name}/places"):
                assert counts[f"/world/{path}"] == len(history["snapshot"])
    for path in ("world/reckoned/place", "world/reckoned/drift", "world/reckoned/leg", "encoders/drift"):
        assert counts[f"/{path}"] == readings
    assert counts["/world/reckoned/path"] == counts["/world/drive/path"]
    assert {"/encoders/faults", "/encoders/segments"} <= set(counts)
    assert {"/world/room", "/world/floor_plan", "/report/figures", "/report/text"} <= set(counts)


def test_ticks_are_counted_from_reading_to_reading_of_a_segment(run: Path) -> None:
    reading = np.load(run / "recording" / "reading.npy")
    rows = read_entity(run / RECORDING, "drive/ticks/right")
    rows = rows.filter(pc.field(DRIVE_TIME).is_valid()).sort_by(DRIVE_TIME)
    expected = [later[3] - before[3] for before, later in pairwise(reading) if before[0] == later[0]]
    np.testing.assert_array_equal(np.concatenate(rows["Scalars:scalars"].to_pylist()), expected)


@pytest.mark.parametrize("method", METHODS)
def test_every_arrow_and_dot_says_its_error_in_the_tooltip(run: Path, method: str) -> None:
    """The viewer lists at most three components that differ from arrow to arrow."""
    accepted, refused = split_by_acceptance(read_all_headings(run)[method])
    large = accepted.error > 0.1
    assert (len(refused.error) > 0) == (method in REFUSING)
    for part, field, before in (
        ("above_10_cm", accepted.take(large), ""),
        ("below_10_cm", accepted.take(~large), ""),
        ("refused", refused, "refused: "),
    ):
        radii = [""] * len(field.error) if field.radius is None else [f" (± {100 * one:.1f})" for one in field.radius]
        expected = [
            f"{before}{100 * error:.1f}{within} cm, {round(np.degrees(heading)) % 360}° → {x:z.2f}, {y:z.2f}"
            for error, within, heading, (x, y) in zip(field.error, radii, field.heading, field.predicted, strict=True)
        ]
        for shape, position in (("arrows", "LineStrips3D:strips"), ("places", "Points3D:positions")):
            rows = read_entity(run / RECORDING, f"world/error_field/{method}/worst/{part}/{shape}")
            values = {
                name: column.combine_chunks().flatten()
                for name, column in zip(rows.column_names, rows.columns, strict=True)
            }
            assert values["error"].to_pylist() == expected
            assert values["method"].to_pylist() == [title_of(method)]
            assert len(values[position]) == len(expected)
            assert sum(len(column) > 1 for column in values.values()) <= 3


def test_each_heading_can_be_switched_on(run: Path) -> None:
    with np.load(run / "error_field.npz") as arrays:
        truth, heading, predicted = arrays["truth"], arrays["heading"], arrays["deepgps"]
    for number, one in enumerate(heading):
        path = f"world/error_field/deepgps/heading/{round(np.degrees(one)) % 360:03d}_deg"
        rows = read_entity(run / RECORDING, f"{path}/arrows")
        strips = np.array(rows["LineStrips3D:strips"].combine_chunks().flatten().to_pylist())
        np.testing.assert_allclose(strips[:, 0, :2], truth, atol=1e-6)
        np.testing.assert_allclose(strips[:, 1, :2], predicted[:, number], atol=1e-6)
        hidden = [
            entity for entity, values in read_layout(run / RECORDING, "EntityBehavior:visible") if not all(values)
        ]
        assert any(entity.endswith(f"{path}/visualizers") for entity in hidden)


def test_the_density_counts_every_training_image(run: Path) -> None:
    rows = read_entity(run / RECORDING, DENSITY)
    assert sum(rows["images"].combine_chunks().flatten().to_pylist()) == SAMPLES


def test_coverage_and_density_are_drawn_between_the_floor_plan_and_the_arrows(run: Path) -> None:
    floor = read_entity(run / RECORDING, "world/floor_plan")["GridMap:translation"].to_pylist()[0][0][2]
    arrows = read_entity(run / RECORDING, "world/error_field/deepgps/heading/000_deg/arrows")
    above = np.array(arrows["LineStrips3D:strips"].combine_chunks().flatten().to_pylist())[..., 2].min()
    for layer in (COVERAGE, DENSITY):
        rows = read_entity(run / RECORDING, layer)
        middle, half = (np.array(rows[f"Boxes3D:{part}"].to_pylist()[0])[:, 2] for part in ("centers", "half_sizes"))
        # a gap of 3.5 mm was too small: the viewer drew the floor plan over the layer
        assert len(middle) and (floor + 0.009 < middle - half).all() and (middle + half + 0.009 < above).all()


def test_both_timelines_of_places_end_with_the_worst_of_the_first_method(run: Path) -> None:
    fields = read_all_headings(run)
    places = find_places(fields)
    rows = read_entity(run / RECORDING, "place/text")
    for timeline in (PLACE, PROGRESS):
        there = rows.filter(pc.field(timeline).is_valid()).sort_by([(timeline, "descending")])
        texts = ["".join(text) for text in there["TextDocument:text"].to_pylist()]
        for place, text in zip(places, texts, strict=True):
            error = 100 * fields[place.method].error[place.cell, place.heading]
            assert text.startswith(f"# {title_of(place.method)}: {error:.1f} cm")
            if place.rank == 1:
                assert error == pytest.approx(100 * fields[place.method].error.max())
    number = rows.filter(pc.field(PLACE).is_valid())[PLACE].to_pylist()
    assert sorted(number) == list(range(1, len(places) + 1))
    counts = rows_by_entity(run / RECORDING)
    for name in PICTURES:
        for kind in ("round", "polar"):
            assert counts[f"/place/{name}/{kind}"] == counts["/world/place/error"] == len(places)


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
    fields = read_all_headings(run)
    for method, field in fields.items():
        cells = [place.cell for place in find_places(fields) if place.method == method]
        errors = field.error[cells].max(axis=1)
        assert (np.diff(errors) <= 0).all()
        assert pdist(field.truth[cells]).min() > 0.25


def test_large_pictures_are_shown_where_they_were_drawn(copied: Path) -> None:
    observation, poses = choose_views(copied)
    assert len(observation) == len(poses) <= SAMPLES
    picture = np.zeros((32, 32, 3), np.uint8)
    write_pictures(copied, observation, np.repeat(picture[None], len(observation), axis=0))
    counts = rows_by_entity(write_run(copied))
    assert counts["/drive/large"] == len(observation)
    assert find_missing(copied / RECORDING) == []


def test_the_robot_is_as_large_as_it_is_and_not_as_odometry_has_it(copied: Path) -> None:
    body = read_entity(copied / RECORDING, f"{ROBOT}/body")["Cylinders3D:radii"].to_pylist()
    path = copied / "recording" / "manifest.json"
    manifest = read_json(path)
    manifest["odometry"]["track_m"] *= 1.1
    manifest["settings"]["encoder"] = {"track_error": 0.1}
    write_json(path, manifest)
    again = read_entity(write_run(copied), f"{ROBOT}/body")["Cylinders3D:radii"].to_pylist()
    np.testing.assert_allclose(again, body)


def test_the_timelines_hold_no_wall_clock(run: Path) -> None:
    reader = RrdReader(run / RECORDING)
    names = {name for chunk in reader.stream() for name in chunk.timeline_names}
    assert names == {DRIVE_TIME, STEP, PLACE, PROGRESS}


def test_a_blueprint_is_embedded(run: Path) -> None:
    assert len(RrdReader(run / RECORDING).blueprints()) >= 1


def test_every_view_shows_what_was_logged(run: Path, copied: Path) -> None:
    assert find_missing(run / RECORDING) == []
    for path in copied.glob("*/history.npz"):
        path.unlink()
    assert find_missing(write_run(copied)) == []


def test_the_last_minutes_are_as_long_on_the_timeline_of_all(copied: Path) -> None:
    path = copied / "recording" / "time.npy"
    np.save(path, 1000 * np.load(path))
    finish_recording(path.parent, read_manifest(path.parent).model_dump(by_alias=True))
    drive_s = np.ptp(np.load(path))
    assert drive_s > 3600
    starts = set()
    for _, ranges in read_layout(write_run(copied), "VisibleTimeRanges:ranges"):
        begins = {one["timeline"]: one["range"]["start"] for one in ranges}
        if begins[DRIVE_TIME] is not None:
            starts.add(begins[DRIVE_TIME] / 1e9)
            assert begins[PROGRESS] / 1e9 / PROGRESS_END_S * drive_s == pytest.approx(begins[DRIVE_TIME] / 1e9, abs=2)
    assert starts == {-60, -120}


def test_equal_runs_give_equal_contents(run: Path, copied: Path) -> None:
    write_run(copied)
    pair = [str(folder / RECORDING) for folder in (run, copied)]
    ids = [RrdReader(path).recordings()[0].recording_id for path in pair]
    assert ids[0] == ids[1]
    compared = subprocess.run(
        [find_viewer(), "rrd", "compare", "--unordered", *pair], check=False, capture_output=True, text=True
    )
    assert compared.returncode == 0, compared.stderr


def test_the_file_verifies(run: Path) -> None:
    command = [find_viewer(), "rrd", "verify", str(run / RECORDING)]
    verified = subprocess.run(command, check=False, capture_output=True, text=True)
    assert verified.returncode == 0, verified.stderr


def test_images_of_a_long_drive_are_thinned(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive, "IMAGES_AT_MOST", 25)
    counts = rows_by_entity(write_run(copied))
    assert counts["/drive/fisheye"] == counts["/drive/polar"] == 20  # every third of 60
    assert counts[f"/{ROBOT}"] == SAMPLES


def test_a_method_that_is_not_there_is_told_with_those_that_are(run: Path) -> None:
    with pytest.raises(InputError, match="no method 'gps'; it has dead_reckoned_labels, deepgps, knn, posenet"):
        read_error_field(run / RECORDING, "gps")


def test_a_missing_recording_is_written_when_it_is_looked_for(copied: Path) -> None:
    (copied / RECORDING).unlink()
    assert find_recording(copied).is_file()


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.999])
def test_a_cut_off_recording_is_one_clear_line(copied: Path, keep: float) -> None:
    path = copied / RECORDING
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    (copied / f"{RECORDING}.sha256").unlink()  # as a version before checksums left it
    with pytest.raises(InputError, match=r"run.rrd is truncated or no recording") as caught:
        view([copied])
    assert "\n" not in str(caught.value)


def test_a_damaged_recording_is_made_again_and_said(copied: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = copied / RECORDING
    before = path.read_bytes()
    path.write_bytes(before[:-7] + b"x" + before[-6:])
    assert find_recording(copied) == path
    assert read_error_table(path).num_rows
    assert f"{path} is damaged" in caplog.text


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is not a run: it has no metrics\.json"):
        view([tmp_path])


def test_a_run_half_there_leaves_nothing_half_written(copied: Path) -> None:
    (copied / RECORDING).unlink()
    (copied / "recording" / "scene.glb").write_bytes(b"half")
    with pytest.raises(InputError, match=r"scene.glb is damaged"):
        view([copied])
    assert not (copied / RECORDING).exists()


def test_a_viewer_without_a_display_is_one_clear_line(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(WorkError, match="without a display, copy") as caught:
        view([run])
    assert "\n" not in str(caught.value)


def test_a_missing_viewer_is_one_clear_line(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nonexistent/python")
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(WorkError, match="the Rerun viewer is missing"):
        view([run])


def test_radii_are_circles_around_the_predictions_of_what_is_accepted(run: Path) -> None:
    for method, field in read_all_headings(run).items():
        if method not in REFUSING:
            with pytest.raises(InputError, match="no entity"):
                read_entity(run / RECORDING, f"world/error_field/{method}/radius")
            continue
        accepted, _ = split_by_acceptance(field)
        rows = read_entity(run / RECORDING, f"world/error_field/{method}/radius")
        circles = np.array(rows["LineStrips3D:strips"].combine_chunks().flatten().to_pylist())[..., :2]
        away = np.linalg.norm(circles - accepted.predicted[:, None], axis=-1)
        assert accepted.radius is not None
        np.testing.assert_allclose(away, np.broadcast_to(accepted.radius[:, None], away.shape), atol=1e-5)
        said = rows["radius"].combine_chunks().flatten().to_pylist()
        assert said[0] == f"68 % within {100 * accepted.radius[0]:.1f} cm, off by {100 * accepted.error[0]:.1f} cm"


def read_by_place(run: Path, entity: str, component: str) -> list[list]:
    """What an entity shows at each of the worst places, in their order."""
    rows = read_entity(run / RECORDING, entity)
    (name,) = [name for name in rows.column_names if component in name]
    return rows.filter(pc.field(PLACE).is_valid()).sort_by([(PLACE, "descending")])[name].to_pylist()


def test_a_worst_place_shows_its_radii_and_says_whether_it_was_refused(run: Path) -> None:
    fields = read_all_headings(run)
    places = find_places(fields)
    texts, labels = read_by_place(run, "place/text", ":text"), read_by_place(run, "world/place/test/label", ":labels")
    circles = read_by_place(run, "world/place/radius", ":strips")
    assert len(texts) == len(circles) == len(places)
    for (text,), drawn, (label,), place in zip(texts, circles, labels, places, strict=True):
        field, at = fields[place.method], (place.cell, place.heading)
        told = place.method in REFUSING
        assert len(drawn) == (2 if told else 0)
        assert ("The method refuses this image." in text) == label.endswith("refused") == (not field.is_accepted[at])
        assert ("The method accepts this image." in text) == (told and field.is_accepted[at])
        assert not told or f"within {100 * np.asarray(field.radius)[at]:.1f} cm (68 %)" in text


def test_the_first_page_begins_with_what_is_wrong(copied: Path) -> None:
    metrics = read_json(copied / "metrics.json")
    metrics["methods"]["deepgps"]["scale"] = 0.5
    write_json(copied / "metrics.json", metrics)
    write_run(copied)
    (text,) = read_entity(copied / RECORDING, "report/figures")["TextDocument:text"].combine_chunks().flatten()
    lines = str(text).splitlines()
    (wrong,) = (place for place, line in enumerate(lines) if line.startswith("- **Not converged: DeepGPS (scale 0.50)"))
    first = lines.index(f"- {describe(metrics)[0]}")
    assert wrong < first
    assert any("% accepted" in line for line in lines[:wrong])
