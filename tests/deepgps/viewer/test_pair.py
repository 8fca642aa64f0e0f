"""Two runs in one recording: what changed where, both fields read back, and the runs left as they were."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from deepgps.config.scenario import Scenario, write_out
from deepgps.evaluation.error_field import read_all_headings, split_by_acceptance
from deepgps.viewer.pair import Pair, colours_of_change, describe_pair, open_pair, write_pair
from deepgps.viewer.show import view
from sim.errors import InputError
from sim.files.checksums import sha256, write_lines
from tests.helpers.blueprints import call_rerun, find_missing, read_entity, read_error_field, read_static
from tests.helpers.command import deepgps_here
from tests.helpers.synthetic_run import METHODS, write_synthetic_run


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


def describe(pair: Pair) -> str:
    """The comparison with single spaces."""
    return re.sub(" +", " ", describe_pair(pair))


def test_the_change_and_both_fields_read_back_as_they_were_measured(runs: tuple[Path, Path], written: Path) -> None:
    for method in METHODS:
        a, b = (100 * worst_errors(run, method) for run in runs)
        said = read_static(written, f"a/change/{method}", "change")
        expected = [f"{two - one:+.1f} cm: A {one:.1f}, B {two:.1f}" for one, two in zip(a, b, strict=True)]
        assert said == expected
        with np.load(runs[0] / "error_field.npz") as arrays:
            place = np.array(read_static(written, f"a/change/{method}", "Points3D:positions"))[:, :2]
            np.testing.assert_allclose(place, arrays["truth"], atol=1e-6)
        for root, run in zip("ab", runs, strict=True):
            parts = split_by_acceptance(read_all_headings(run)[method])
            ends = [np.concatenate([getattr(part, one) for part in parts]) for one in ("truth", "predicted")]
            np.testing.assert_allclose(read_error_field(written, method, root), ends, atol=1e-6)


def test_the_other_way_round_every_change_turns_its_sign(runs: tuple[Path, Path]) -> None:
    there, back = open_pair(runs), open_pair(runs[::-1])
    for method in METHODS:
        change = there.change(method)
        np.testing.assert_array_equal(change, -back.change(method))
        better, worse = int((change < -0.01).sum()), int((change > 0.01).sum())
        same = len(change) - better - worse
        assert f" | {better} | {same} | {worse} |" in describe(there)
        assert f" | {worse} | {same} | {better} |" in describe(back)


def test_a_run_and_its_copy_differ_nowhere_and_two_runs_stand_beside_each_other(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    pair = open_pair([runs[0], Path(shutil.copytree(runs[0], tmp_path / "copy"))])
    text = describe(pair)
    assert pair.same_floor and all(not pair.change(method).any() for method in METHODS)
    assert "Both runs have the same settings." in text and text.count("| 1.00") == 4 * len(METHODS)
    a, b = (np.sqrt(np.mean(worst_errors(run, "deepgps") ** 2)) for run in runs)
    text = describe(open_pair(runs))
    assert f"| DeepGPS | {100 * a:.1f} | {100 * b:.1f} | {b / a:.2f} |" in text
    assert "| encoder.step_noise | 0.0 | 0.1 |" in text


def test_settings_that_are_not_written_are_compared_at_their_defaults(copied: tuple[Path, Path]) -> None:
    write_lines(copied[1] / "scenario.yaml", "image_faults: {exposure: 2.0}\nname: living_room\n")
    rows = [line for line in describe(open_pair(copied)).splitlines() if line.startswith("| image_faults.")]
    assert rows == ["| image_faults.exposure | 1.0 | 2.0 |"]
    changed = {"deployment": {"daylight": 0.3}, "learn": {"features": {"values": "ranks"}}, "drive": {"search": 0.5}}
    plain, other = Scenario(name="living_room"), Scenario.model_validate({"name": "living_room", **changed})
    for pair in ((plain, other), (other, plain)):
        for folder, scenario in zip(copied, pair, strict=True):
            write_lines(folder / "scenario.yaml", write_out(scenario))
        text = describe(open_pair(copied))
        assert all(f"| {name} |" in text for name in ("deployment.daylight", "learn.features.values", "drive.search"))


def test_changes_are_drawn_on_one_fixed_scale() -> None:
    change = np.array([-5.0, -1.0, -0.1, -0.01, 0.0, 0.005, 0.01, 0.1, 1.0, 5.0])
    colours = colours_of_change(change).astype(int)
    redder = colours[:, 0] - colours[:, 2]
    assert (np.diff(redder) >= 0).all() and redder[0] < -100 and redder[-1] > 100  # blue: better; red: worse
    same = (colours[np.abs(change) <= 0.01] == colours[4]).all()
    assert same and (colours[0] == colours[1]).all() and np.ptp(colours[4, :3]) < 10


def test_different_test_positions_stand_side_by_side_only(runs: tuple[Path, Path], tmp_path: Path) -> None:
    path = write_pair([runs[0], write_synthetic_run(tmp_path / "other", samples=40, spacing_m=0.5)])
    entities = {chunk.entity_path for chunk in RrdReader(path).stream()}
    assert not any(entity.startswith("/a/change") for entity in entities)
    assert {f"/{root}/error_field/deepgps/accepted/arrows" for root in "ab"} <= entities
    (text,) = read_entity(path, "report/pair")["TextDocument:text"].to_pylist()
    assert "The rooms or test positions differ" in text[0]
    assert find_missing(path) == []


def test_only_methods_of_both_are_shown(copied: tuple[Path, Path]) -> None:
    with np.load(copied[1] / "error_field.npz") as arrays:
        kept = {name: arrays[name] for name in ("truth", "heading", "knn", "deepgps")}
    np.savez(copied[1] / "error_field.npz", **kept)
    assert list(open_pair(copied).methods) == ["deepgps", "knn"]
    explicit = np.repeat(kept["truth"][:, None], 4, axis=1)
    np.savez(copied[1] / "error_field.npz", truth=kept["truth"], heading=kept["heading"], explicit=explicit)
    with pytest.raises(InputError, match=r"no method is in both runs: .* has deepgps, .*, .* has explicit"):
        view(copied)


def test_the_same_pair_gives_the_same_file_and_both_runs_stay_as_they_are(copied: tuple[Path, Path]) -> None:
    def files() -> dict[Path, str]:
        found = [path for run in copied for path in run.rglob("*") if path.is_file() and path.parent.name != "pairs"]
        return {path: sha256(path) for path in found}

    before = files()
    first = write_pair(copied)
    kept = first.rename(first.with_name("kept.rrd"))
    assert write_pair(copied) == first
    assert files() == before
    assert [path.name for path in copied[1].rglob("*.rrd")] == []
    call_rerun("compare", "--unordered", kept, first)
    kept.unlink()
    write_lines(copied[1] / "scenario.yaml", "name: living_room\nlearn: {seed: 7}\n")
    assert write_pair(copied) != first


def test_every_view_shows_what_was_logged_and_the_file_verifies(written: Path) -> None:
    assert find_missing(written) == []
    call_rerun("verify", written)


def test_the_command_writes_a_missing_or_damaged_recording_and_says_where_it_is(
    copied: tuple[Path, Path], tmp_path: Path, without_display: None
) -> None:
    for _ in range(2):
        done = deepgps_here("view", *map(str, copied), cwd=tmp_path)
        assert done.returncode == 1 and len(done.stderr.strip().splitlines()) == 1, done.stderr
        found = re.search(r"copy (\S+/pairs/\w+\.rrd) to a machine", done.stderr)
        assert found
        path = Path(found[1])
        assert all(len(read_error_field(path, method, "b")[0]) for method in METHODS)
        path.write_bytes(path.read_bytes()[:1000])


def test_what_is_no_pair_of_whole_runs_is_one_clear_line(copied: tuple[Path, Path], tmp_path: Path) -> None:
    def refuse(paths: list[Path], message: str) -> None:
        with pytest.raises(InputError, match=message) as caught:
            view(paths)
        assert "\n" not in str(caught.value)

    refuse([copied[0], copied[0].parent / "." / copied[0].name], "are the same run")
    refuse([*copied, tmp_path], "exactly two runs can be compared, not 3")
    for number, missing in enumerate(
        ("metrics.json", "scenario.yaml", "error_field.npz", "recording/manifest.json", "recording/truth/pose.npy")
    ):
        half = Path(shutil.copytree(copied[1], tmp_path / f"half{number}"))
        (half / missing).unlink()
        refuse([copied[0], half], rf"half{number}.*{Path(missing).stem}\.")
