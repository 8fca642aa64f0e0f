"""Two runs in one recording: what changed where, both fields read back, and the runs left as they were."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deepgps.config.scenario import Scenario, write_out
from deepgps.viewer.pair import (
    Pair,
    colours_of_change,
    describe_pair,
    open_pair,
    scale_change,
    write_pair,
)
from deepgps.viewer.read import read_entity, read_error_table
from deepgps.viewer.window.connect import find_viewer
from deepgps.viewer.window.show import view
from sim.errors import InputError, WorkError
from sim.files.checksums import sha256, write_lines
from tests.helpers.blueprints import find_missing
from tests.helpers.command import deepgps_here
from tests.helpers.synthetic_run import METHODS, write_synthetic_run

COLUMNS = ("x_m", "y_m", "predicted_x_m", "predicted_y_m", "error_m")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("runs")
    pair = tuple(
        write_synthetic_run(folder / name, samples=40, seed=seed, spacing_m=0.4) for seed, name in enumerate("ab")
    )
    for run, noise in zip(pair, ("0", "0.1"), strict=True):
        write_lines(run / "scenario.yaml", f"name: living_room\nencoder: {{step_noise: {noise}}}\nmethods: [deepgps]\n")
    return pair[0], pair[1]


@pytest.fixture(scope="module")
def written(runs: tuple[Path, Path]) -> Path:
    rr.set_strict_mode(True)
    path = write_pair(runs)
    rr.set_strict_mode(False)
    return path


@pytest.fixture
def copied(runs: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    return runs[0], Path(shutil.copytree(runs[1], tmp_path / "copy"))


def worst_errors(run: Path, method: str) -> np.ndarray:
    with np.load(run / "error_field.npz") as arrays:
        return np.linalg.norm(arrays[method] - arrays["truth"][:, None], axis=-1).max(axis=1)


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).stream()}


@pytest.mark.parametrize("method", METHODS)
def test_the_change_reads_back_as_it_was_measured(runs: tuple[Path, Path], written: Path, method: str) -> None:
    rows = read_entity(written, f"change/field/{method}")
    change = worst_errors(runs[1], method) - worst_errors(runs[0], method)
    np.testing.assert_allclose(np.concatenate(rows["change_m"].to_pylist()), change, atol=1e-12)
    rows = read_entity(written, f"change/field/{method}/places")
    places = np.array(rows["Points3D:positions"].to_pylist()[0])[:, :2]
    with np.load(runs[0] / "error_field.npz") as arrays:
        np.testing.assert_allclose(places, arrays["truth"], atol=1e-6)


def test_the_fields_of_both_runs_read_back(runs: tuple[Path, Path], written: Path) -> None:
    for root, run in zip("ab", runs, strict=True):
        table = read_error_table(written, root)
        for method in METHODS:
            rows = table.filter(pc.field("method") == method)
            np.testing.assert_allclose(rows["error_m"], worst_errors(run, method), atol=1e-6)


def test_the_other_way_round_every_change_turns_its_sign(runs: tuple[Path, Path]) -> None:
    there, back = open_pair(runs), open_pair(runs[::-1])
    for method in METHODS:
        change = there.change(method)
        np.testing.assert_array_equal(change, -back.change(method))
        better, worse = int((change < -0.01).sum()), int((change > 0.01).sum())
        same = len(change) - better - worse
        assert f" | {better} | {same} | {worse} |" in describe(there)
        assert f" | {worse} | {same} | {better} |" in describe(back)


def describe(pair: Pair) -> str:
    """The comparison with single spaces."""
    return re.sub(" +", " ", describe_pair(pair))


def test_a_run_and_its_copy_differ_nowhere(runs: tuple[Path, Path], tmp_path: Path) -> None:
    pair = open_pair([runs[0], Path(shutil.copytree(runs[0], tmp_path / "copy"))])
    text = describe(pair)
    assert pair.same_floor
    assert all(not pair.change(method).any() for method in METHODS)
    assert "Both runs have the same settings." in text
    assert text.count("| 1.00") == 4 * len(METHODS)


def test_figures_and_settings_stand_beside_each_other(runs: tuple[Path, Path]) -> None:
    a, b = (np.sqrt(np.mean(worst_errors(run, "deepgps") ** 2)) for run in runs)
    text = describe(open_pair(runs))
    assert f"| DeepGPS | {100 * a:.1f} | {100 * b:.1f} | {b / a:.2f} |" in text
    assert "| encoder.step_noise | 0.0 | 0.1 |" in text


def test_a_run_made_before_some_settings_were_there_has_them_as_they_are_by_default(copied: tuple[Path, Path]) -> None:
    write_lines(copied[1] / "scenario.yaml", write_out(Scenario(name="living_room")))
    assert "Both runs have the same settings." in describe(open_pair(copied))
    write_lines(copied[1] / "scenario.yaml", "image_faults: {exposure: 2.0}\nname: living_room\n")
    rows = [line for line in describe(open_pair(copied)).splitlines() if line.startswith("| image_faults.")]
    assert rows == ["| image_faults.exposure | 1.0 | 2.0 |"]


def test_settings_that_are_not_written_at_their_defaults_are_compared_as_well(copied: tuple[Path, Path]) -> None:
    changed = {"deployment": {"daylight": 0.3}, "learn": {"features": {"values": "ranks"}}, "drive": {"arcs": 0.5}}
    plain, other = Scenario(name="living_room"), Scenario.model_validate({"name": "living_room", **changed})
    for pair in ((plain, other), (other, plain)):
        for folder, scenario in zip(copied, pair, strict=True):
            write_lines(folder / "scenario.yaml", write_out(scenario))
        text = describe(open_pair(copied))
        assert all(f"| {name} |" in text for name in ("deployment.daylight", "learn.features.values", "drive.arcs"))


def test_changes_are_drawn_on_one_fixed_scale() -> None:
    change = np.array([-5.0, -1.0, -0.1, -0.01, 0.0, 0.005, 0.01, 0.1, 1.0, 5.0])
    share = scale_change(change)
    np.testing.assert_allclose(share, [-1, -1, -0.5, 0, 0, 0, 0, 0.5, 1, 1], atol=1e-12)
    np.testing.assert_array_equal(share, -scale_change(-change))
    colours = colours_of_change(np.array([-1.0, 0.0, 1.0])).astype(int)
    assert colours[0, 2] > colours[0, 0]  # blue: better
    assert np.ptp(colours[1, :3]) < 30  # grey: the same
    assert colours[2, 0] > colours[2, 2]  # orange: worse


def test_different_test_positions_stand_side_by_side_only(runs: tuple[Path, Path], tmp_path: Path) -> None:
    other = write_synthetic_run(tmp_path / "other", samples=40, spacing_m=0.5)
    path = write_pair([runs[0], other])
    assert not any(entity.startswith("/change") for entity in entities(path))
    assert {f"/{root}/error_field/deepgps" for root in "ab"} <= entities(path)
    (text,) = read_entity(path, "report/pair")["TextDocument:text"].to_pylist()
    assert "The rooms or test positions differ" in text[0]


def test_only_methods_of_both_are_shown(copied: tuple[Path, Path]) -> None:
    with np.load(copied[1] / "error_field.npz") as arrays:
        kept = {name: arrays[name] for name in ("truth", "heading", "knn", "deepgps")}
    np.savez(copied[1] / "error_field.npz", **kept)
    assert list(open_pair(copied).methods) == ["deepgps", "knn"]
    kept = {name: kept[name] for name in ("truth", "heading")}
    np.savez(copied[1] / "error_field.npz", **kept, explicit=arrays_like(kept["truth"]))
    with pytest.raises(InputError, match=r"no method is in both runs: .* has deepgps, .*, .* has explicit"):
        view(copied)


def arrays_like(truth: np.ndarray) -> np.ndarray:
    return np.repeat(truth[:, None], 4, axis=1)


def test_the_runs_stay_as_they_are_and_the_same_pair_gives_the_same_contents(copied: tuple[Path, Path]) -> None:
    def files() -> dict[Path, str]:
        found = [path for run in copied for path in run.rglob("*") if path.is_file() and path.parent.name != "pairs"]
        return {path: sha256(path) for path in found}

    before = files()
    first = write_pair(copied)
    kept = first.with_name("kept.rrd")
    first.rename(kept)
    assert write_pair(copied) == first
    assert files() == before
    assert [path.name for path in copied[1].rglob("*.rrd")] == []
    command = [find_viewer(), "rrd", "compare", "--unordered", str(kept), str(first)]
    assert subprocess.run(command, check=False, capture_output=True).returncode == 0
    kept.unlink()


def test_what_stands_is_not_written_again_unless_settings_changed(copied: tuple[Path, Path]) -> None:
    first = write_pair(copied)
    before = first.stat().st_mtime_ns
    assert write_pair(copied).stat().st_mtime_ns == before
    write_lines(copied[1] / "scenario.yaml", "name: living_room\nlearn: {seed: 7}\n")
    assert write_pair(copied) != first


def test_every_view_shows_what_was_logged(runs: tuple[Path, Path], written: Path, tmp_path: Path) -> None:
    assert find_missing(written) == []
    assert find_missing(write_pair([runs[0], write_synthetic_run(tmp_path, samples=40, spacing_m=0.5)])) == []


def test_the_file_verifies(written: Path) -> None:
    verified = subprocess.run(
        [find_viewer(), "rrd", "verify", str(written)], check=False, capture_output=True, text=True
    )
    assert verified.returncode == 0, verified.stderr
    assert len(RrdReader(written).blueprints()) >= 1


def test_the_command_makes_the_recording_and_says_where_it_is(
    copied: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    done = deepgps_here("view", *map(str, copied), cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    found = re.search(r"copy (\S+/pairs/\w+\.rrd) to a machine", done.stderr)
    assert found
    assert read_error_table(Path(found[1]), "b").num_rows


def test_a_run_beside_itself_is_refused(runs: tuple[Path, Path]) -> None:
    with pytest.raises(InputError, match="are the same run"):
        view([runs[0], runs[0].parent / "." / runs[0].name])


def test_three_runs_are_refused(runs: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="exactly two runs can be compared, not 3"):
        view([*runs, tmp_path])


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("metrics.json", r"copy is not a run: it has no metrics\.json"),
        ("scenario.yaml", r"copy is no run folder: it has no scenario\.yaml"),
        ("error_field.npz", r"copy is no whole run: error_field\.npz is missing"),
        ("recording/manifest.json", r"recording is no finished recording: it has no manifest\.json"),
        ("recording/truth/pose.npy", r"pose\.npy is missing"),
    ],
)
def test_a_run_half_there_is_one_clear_line(copied: tuple[Path, Path], missing: str, message: str) -> None:
    (copied[1] / missing).unlink()
    with pytest.raises(InputError, match=message) as caught:
        view(copied)
    assert "\n" not in str(caught.value)


def test_a_cut_off_recording_of_a_pair_is_written_again(copied: tuple[Path, Path], monkeypatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    path = write_pair(copied)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(WorkError, match=r"without a display, copy .*/pairs/\w+\.rrd"):
        view(copied)
    assert set(read_error_table(path, "b")["method"].to_pylist()) == set(METHODS)
