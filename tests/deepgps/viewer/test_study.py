"""The recording of a study: what each slider shows is what was measured; whole, repeatable, and clear errors."""

import os
import shutil
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deepgps.studies.plan import Plan, plan_runs
from deepgps.studies.study import load_study
from deepgps.studies.table import gather, write_table
from deepgps.viewer import study as viewer
from deepgps.viewer.error_field import ACCEPTED_PART, REFUSED_PART
from deepgps.viewer.scene import draw_floor_plan
from deepgps.viewer.show import view
from deepgps.viewer.sliders import find_sliders
from deepgps.viewer.study import STUDY as STUDY_RRD
from deepgps.viewer.study import find_study, write_length
from deepgps.viewer.study import write_study as write_rrd
from sim.errors import InputError
from tests.helpers.blueprints import call_rerun, find_missing, read_entity
from tests.helpers.command import deepgps_here, wait_until
from tests.helpers.small_study import finish, start, write_study
from tests.helpers.synthetic_study import METHODS, NOISES, ROOMS, STUDY, make_room, write_synthetic_study

AXIS = "encoder.step_noise"


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Plan]]:
    folder = tmp_path_factory.mktemp("study")
    plans = write_synthetic_study(folder)
    rr.set_strict_mode(True)
    write_rrd(folder)
    rr.set_strict_mode(False)
    return folder, plans


@pytest.fixture
def copied(study: tuple[Path, list[Plan]], tmp_path: Path) -> Path:
    return Path(shutil.copytree(study[0], tmp_path / "copy", symlinks=True))


def cells(path: Path, entity: str, component: str) -> Iterator[tuple[str, int, Any]]:
    """A component of an entity wherever it stands: timeline, place on it, value."""
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        for timeline in chunk.timeline_names:
            yield from zip(
                [timeline] * chunk.num_rows,
                batch.column(timeline).to_pylist(),
                batch.column(component).to_pylist(),
                strict=True,
            )


def fields(
    path: Path, method: str, parts: Sequence[str] = (ACCEPTED_PART, REFUSED_PART)
) -> dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]:
    """Arrows of a method at every place of every slider in order: where they begin, and their way (n, 2)."""
    strips: dict[tuple[str, int], list[np.ndarray]] = {}
    for part in parts:
        entity = f"/world/error_field/{method}/{part}/arrows"
        for line, at, value in cells(path, entity, "LineStrips3D:strips"):
            strips.setdefault((line, at), []).append(np.reshape(value, (-1, 5, 3))[:, :2, :2])
    ends = {key: in_order(np.concatenate(parts)) for key, parts in strips.items()}
    return {key: (points[:, 0], points[:, 1] - points[:, 0]) for key, points in ends.items()}


def in_order(rows: np.ndarray) -> np.ndarray:
    """Rows (n, ...) in the order of the places (n, 2) that they begin with."""
    place = np.round(rows.reshape(len(rows), int(np.prod(rows.shape[1:])))[:, :2], 4)
    return rows[np.lexsort(place.T)]


def texts(path: Path, entity: str, component: str = "TextDocument:text") -> dict[tuple[str, int], str]:
    return {(line, at): value[0] for line, at, value in cells(path, entity, component)}


def read_text(path: Path, entity: str) -> str:
    return read_entity(path, entity)["TextDocument:text"].to_pylist()[0][0]


def find(plans: list[Plan], room: int, noise: float, seed: int) -> Plan:
    found = {(one.scenario.room.seed, one.scenario.encoder.step_noise, one.scenario.seed): one for one in plans}
    return found[room, noise, seed]


@pytest.mark.parametrize("method", METHODS)
def test_each_place_of_each_slider_shows_the_error_field_of_its_run(study, method):
    folder, plans = study
    shown = fields(folder / STUDY_RRD, method)
    expected = {
        **{(AXIS, index + 1): find(plans, ROOMS[0], noise, 0) for index, noise in enumerate(NOISES)},
        **{("case", index + 1): find(plans, room, NOISES[0], 0) for index, room in enumerate(ROOMS)},
        **{("seed", seed + 1): find(plans, ROOMS[0], NOISES[0], seed) for seed in (0, 1)},
        **{("run", index + 1): plan for index, plan in enumerate(plans)},
    }
    assert shown.keys() == expected.keys()
    for key, plan in expected.items():
        with np.load(folder / "runs" / plan.run / "error_field.npz") as arrays:
            truth, predicted = arrays["truth"], arrays[method]
        error = predicted - truth[:, None]
        worst = error[np.arange(len(truth)), np.linalg.norm(error, axis=-1).argmax(axis=1)]
        expected_rows = in_order(np.concatenate([truth, worst], axis=1))
        np.testing.assert_allclose(np.concatenate(shown[key], axis=1), expected_rows, atol=1e-5)


def test_every_room_is_drawn_at_its_own_size(study):
    corners = {key[:2]: key[2] for key in cells(study[0] / STUDY_RRD, "/world/floor_plan", "GridMap:translation")}
    for index, room in enumerate(ROOMS):
        np.testing.assert_allclose(corners["case", index + 1][0][:2], draw_floor_plan(make_room(room))[1], atol=1e-6)


def test_the_text_says_where_a_slider_stands_and_what_the_others_are(study):
    path = study[0] / STUDY_RRD
    here = texts(path, "/report/here")
    assert here[AXIS, 3].startswith(f"# {AXIS} 0.3\n")
    assert "RMS of all 2 seeds: DeepGPS " in here[AXIS, 3]
    assert "| PoseNet |" in here[AXIS, 3]
    assert here["case", 2].startswith("# case room.seed 2")
    guide = read_text(path, "report/sliders")
    assert f"The slider at the bottom moves `{AXIS}`" in guide
    assert f"- **{AXIS}**: `0`, `0.1`, `0.3` (with room.seed 1, seed 0)" in guide
    assert "- **run**: all 12 runs, one after another" in guide
    assert read_text(path, "report/table") == (study[0] / "table.md").read_text()


def test_the_file_is_whole_and_small_without_wall_clock_and_every_view_shows_what_was_logged(study):
    path = study[0] / STUDY_RRD
    names = {name for chunk in RrdReader(path).stream() for name in chunk.timeline_names}
    assert names == {AXIS, "case", "seed", "run"}
    assert find_missing(path) == []
    assert path.stat().st_size < 2_000_000
    call_rerun("verify", (path))


def test_equal_studies_give_equal_contents_and_an_older_recording_is_written_again(study, copied, monkeypatch):
    (copied / STUDY_RRD).unlink()
    pair = [study[0] / STUDY_RRD, find_study(copied)]
    assert len({RrdReader(path).recordings()[0].recording_id for path in pair}) == 1
    call_rerun("compare", "--unordered", *pair)
    written = []
    monkeypatch.setattr(viewer, "write_study", written.append)
    assert find_study(copied) == pair[1] and not written
    (copied / "table.md").write_text("a report after which the study was interrupted")
    find_study(copied)
    assert written == [copied]


def test_a_run_that_failed_shows_nothing_and_another_seed_stands_in(tmp_path):
    one_room = STUDY.model_copy(update={"cases": ({"room.seed": 1},)})
    plans = write_synthetic_study(tmp_path, one_room, failed=(0, 2, 3))  # noise 0 of seed 0, both of noise 0.1
    path = write_rrd(tmp_path)
    shown = fields(path, "deepgps")
    with np.load(tmp_path / "runs" / plans[1].run / "error_field.npz") as arrays:
        np.testing.assert_allclose(shown[AXIS, 1][0], in_order(arrays["truth"]), atol=1e-5)
    assert len(shown[AXIS, 2][0]) == 0
    assert texts(path, "/report/here")[AXIS, 2].endswith("This run failed: it did not want to")


def test_a_study_that_is_not_whole_is_one_clear_line_that_names_the_file(copied, tmp_path):
    (copied / STUDY_RRD).unlink()
    for number, (lost, content, message) in enumerate(
        [
            ("table.parquet", None, "has no table.parquet"),
            ("table.parquet", "half", "table.parquet is damaged: "),
            ("study.yaml", "sceanrio: x", "study.yaml: made by deepgps 0.1.0, format 1"),
            ("runs/*/error_field.npz", None, "error_field.npz is missing"),
            ("runs/*/error_field.npz", "half", "error_field.npz is damaged"),
            ("recordings/*/manifest.json", None, "recording/manifest.json is missing"),
            ("table.md", None, "table.md is missing"),
        ]
    ):
        half = Path(shutil.copytree(copied, tmp_path / f"half{number}", symlinks=True))
        path = next(half.glob(lost))
        path.unlink() if content is None else path.write_text(content)
        refuse(half, message)
    write_table(copied / "table.parquet", [{"name": "something else"}])
    refuse(copied, "table.parquet is not a study's table")
    write_synthetic_study(tmp_path / "failed", STUDY, failed=tuple(range(12)))
    refuse(tmp_path / "failed", "has no finished run; see its table.md")


def refuse(folder: Path, message: str) -> None:
    with pytest.raises(InputError) as caught:
        view([folder])
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert not (folder / STUDY_RRD).exists()


def test_a_cut_off_recording_is_one_clear_line_and_the_study_repairs_it(copied):
    path = copied / STUDY_RRD
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    (copied / f"{STUDY_RRD}.sha256").unlink()  # as a version before checksums left it
    with pytest.raises(InputError, match=r"study.rrd is truncated or no recording") as caught:
        view([copied])
    assert "\n" not in str(caught.value)
    call_rerun("verify", (write_rrd(copied)))


def rows_of(tmp_path: Path, **changes: Any) -> list[dict[str, Any]]:
    plans = plan_runs(load_study(str(write_study(tmp_path, target={}, **changes)), tiny=False))
    return gather(plans, {plan.run: "made up" for plan in plans}, tmp_path)


def test_an_axis_of_numbers_goes_up_words_stay_in_order_and_the_scenario_is_the_base(tmp_path):
    axes = {"encoder.ticks_per_rev": [4096, 16, 64], "room.seed": [3, 4], "room.shape": ["two_rooms", "rectangle"]}
    rows = rows_of(tmp_path, cases=[{}], axes=axes)
    own = {"room.shape": "rectangle", "encoder.ticks_per_rev": 4096, "room.seed": 0}
    sliders = find_sliders(rows, list(axes), own)
    assert [slider.name for slider in sliders] == ["room.shape", "encoder.ticks_per_rev", "room.seed", "run"]
    assert [step.value for step in sliders[0].steps] == ["two_rooms", "rectangle"]
    assert [step.value for step in sliders[1].steps] == ["16", "64", "4096"]
    assert sliders[0].others == "ticks_per_rev 4096, room.seed 3, seed 0"
    assert {(step.rows[0]["room.shape"], step.rows[0]["room.seed"]) for step in sliders[1].steps} == {("rectangle", 3)}
    assert [step.rows[0]["run"] for step in sliders[3].steps] == list(dict.fromkeys(row["run"] for row in rows))


def test_cases_are_told_apart_by_as_little_as_it_takes(tmp_path):
    cases = [{"scenario": "landmarks", "drive.samples": 500}, {"drive.samples": 600}]
    sliders = find_sliders(rows_of(tmp_path, cases=cases), [], {"scenario": "mini"})
    assert [(slider.name, [step.value for step in slider.steps]) for slider in sliders] == [
        ("case", ["landmarks", "mini"])
    ]


def test_where_the_scenario_is_one_of_many_cases_the_others_say_only_what_they_change(tmp_path):
    cases = [{}, {"encoder.step_noise": 0.1}, {"encoder.dropout": 0.3, "encoder.step_noise": 0.1}]
    rows = rows_of(tmp_path, cases=cases, seeds=[0, 1])
    case, seed, run = find_sliders(rows, [], {"encoder.step_noise": 0.0, "encoder.dropout": 0.0})
    assert [step.value for step in case.steps] == ["no change", "step_noise 0.1", "step_noise 0.1, dropout 0.3"]
    assert (case.others, seed.others) == ("seed 0", "")
    assert [step.value for step in run.steps][::2] == [
        "seed 0",
        "step_noise 0.1, seed 0",
        "step_noise 0.1, dropout 0.3, seed 0",
    ]
    assert run.steps[0].words == "step_noise 0, dropout 0, seed 0"  # the text has all of it
    elsewhere = find_sliders(rows, [], {"encoder.step_noise": 0.2, "encoder.dropout": 0.0})[0]
    assert elsewhere.steps[0].value == "step_noise 0, dropout 0"


def test_a_study_of_one_run_has_a_slider_with_one_place(tmp_path):
    (slider,) = find_sliders(rows_of(tmp_path, cases=[{}]), [], {})
    assert (slider.name, [step.value for step in slider.steps]) == ("run", ["seed 0"])


def test_lengths_are_written_in_the_unit_that_suits_them():
    for length, text in ((1e-9, "0 mm"), (0.00057, "0.57 mm"), (0.0234, "2.3 cm"), (0.999, "99.9 cm"), (2.5, "2.50 m")):
        assert write_length(length) == text


@pytest.mark.slow
def test_a_study_that_was_killed_leaves_its_recording_when_it_is_run_again(tmp_path, without_display):
    tiny = {"set": {"drive.samples": 40}}
    changes = {"scenario": "plane.yaml", "cases": [{}], "axes": {AXIS: [0.0, 0.3]}, "target": {}, "report": "curves"}
    study = write_study(tmp_path, **changes, tiny=tiny)
    out = tmp_path / "out"
    process = start(study, out, "--tiny")
    wait_until(lambda: list(out.glob("runs/*/metrics.json")), process)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert not (out / STUDY_RRD).exists()
    (out / f"{STUDY_RRD}.1.deepgps-part").write_text("half")
    done = deepgps_here("view", str(out), cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        f"error: {out} is not a finished study: it has no table.parquet (deepgps study writes it)\n",
    )
    said = finish(start(study, out, "--tiny"))
    assert f"look at it: deepgps view {out}, or at a run: deepgps view {out}/runs/" in said
    assert not list(out.glob("*.deepgps-part"))
    call_rerun("verify", (out / STUDY_RRD))
    runs = {plan.scenario.encoder.step_noise: plan.run for plan in plan_runs(load_study(str(study), tiny=True))}
    for place, noise in enumerate((0.0, 0.3), 1):
        with np.load(out / "runs" / runs[noise] / "error_field.npz") as arrays:
            shown = fields(out / STUDY_RRD, "deepgps")[AXIS, place]
            places = {tuple(place) for place in shown[0].round(4).tolist()}  # one with headings of both kinds is in two
            assert places == {tuple(place) for place in arrays["truth"].round(4).tolist()}
    done = deepgps_here("view", str(out), cwd=tmp_path)
    assert done.returncode == 1
    assert f"without a display, copy {out / STUDY_RRD} to a machine that has one" in done.stderr
