"""Several drives at once: the same bytes as in turn, and one that fails, or whose process dies, fails alone."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from deepgps.studies.engine import recordings
from deepgps.studies.engine.recordings import collect_all, count_drives, record_all
from deepgps.studies.plan import Plan, plan_runs
from deepgps.studies.study import load_study
from deepgps.terminal.progress import ignore
from sim.recording.format import is_whole, read_manifest
from tests.helpers.small_study import write_study

ROOMS = [{"room.seed": 0}, *({"room.seed": 1, "deployment.light": light} for light in (1.0, 0.5, 0.4))]
"""The last three share a training drive."""
PLANES = [{"landmarks.count": 20}, {"landmarks.count": 21}]


def plan(folder: Path, cases: Sequence[Mapping[str, object]], scenario: str = "mini.yaml") -> list[Plan]:
    folder.mkdir()
    return plan_runs(load_study(str(write_study(folder, cases=cases, scenario=scenario, target={})), tiny=False))


def at_once(monkeypatch: pytest.MonkeyPatch, cores: int) -> None:
    monkeypatch.setattr(recordings, "SAMPLES_PER_PROCESS", 10)
    monkeypatch.setattr(recordings, "usable_cores", lambda: cores)


@pytest.mark.parametrize(
    ("cores", "drives", "samples", "most"),
    [(2, 10, 80_000, 2), (16, 3, 48_000, 3), (16, 10, 500, 1), (16, 10, 3000, 4), (8, 0, 0, 1)],
)
def test_as_many_drives_at_once_as_pay(
    cores: int, drives: int, samples: int, most: int, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(recordings, "usable_cores", lambda: cores)
    assert count_drives(drives, samples) == most


@pytest.mark.parametrize(
    ("cases", "scenario"), [(PLANES, "plane.yaml"), pytest.param(ROOMS, "mini.yaml", marks=pytest.mark.slow)]
)
def test_drives_at_once_give_the_same_bytes(
    cases: Sequence[Mapping[str, object]], scenario: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    found, told = [], list[tuple[str, int, int]]()
    for cores in (1, 4):
        at_once(monkeypatch, cores)
        plans, home = plan(tmp_path / str(cores), cases, scenario), tmp_path / str(cores) / "out"
        told.clear()
        assert record_all(plans, plans, home, lambda *what: told.append(what[:3])) == {}
        assert ("recordings", 60 * len(cases), 60 * len(cases)) in told
        made = [home / "recordings" / one.recording for one in plans]
        _, base, *others = made  # a plane has no others
        shared = [path.relative_to(base) for path in base.glob("observations/*.npy")]
        assert shared and all((one / path).samefile(base / path) for one in others for path in shared)
        found.append([read_manifest(one).sha256 for one in made])
    assert found[0] == found[1]


@pytest.mark.slow
def test_drives_whose_base_fails_make_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    at_once(monkeypatch, 2)
    plans, home = plan(tmp_path / "study", ROOMS[1:]), tmp_path / "out"
    base, *others = (home / "recordings" / one.recording for one in plans)
    base.parent.mkdir(parents=True)
    base.write_text("in the way")
    assert list(record_all(plans, plans, home, ignore)) == [base.name]
    assert all(map(is_whole, others))


@pytest.mark.parametrize("cores", [1, 2])
def test_a_drive_that_fails_and_one_with_a_bug_fail_alone(cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    at_once(monkeypatch, cores)
    bad, blocked, good = plan(tmp_path / "study", [*PLANES, {"landmarks.count": 22}], "plane.yaml")
    broken = bad.scenario.model_copy(update={"world": "nowhere"})
    scenarios = {bad.recording: broken, blocked.recording: blocked.scenario, good.recording: good.scenario}
    home = tmp_path / "recordings"
    home.mkdir()
    (home / blocked.recording).write_text("in the way")
    failures = collect_all(scenarios, {key: home / key for key in scenarios}, home, ignore)
    assert set(failures) == {bad.recording, blocked.recording} and is_whole(home / good.recording)
    assert re.match("recording: [A-Z][A-Za-z]+Error: .*nowhere", failures[bad.recording])
    assert failures[blocked.recording].startswith("recording: ")
