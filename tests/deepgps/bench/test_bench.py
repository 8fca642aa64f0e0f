"""A small bench as a user runs it, its parts by their laws, and its errors by their text."""

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from deepgps.bench import bench as benching
from deepgps.bench import rows as bench_rows
from deepgps.bench.memory import Training, measure_peak, read_anonymous, repeat_recording
from deepgps.bench.rows import Row, find_before, list_notes, read_bench, tabulate, write_bench, write_value
from deepgps.bench.speed import locate_naively, measure_speed, measure_spread
from deepgps.config.learning import LearnSettings, NetworkSettings, PixelValues
from deepgps.data.features import Features, describe
from deepgps.data.segments import read_segments
from deepgps.learning.networks import make_network
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.terminal.progress import ignore
from sim.errors import InputError, WorkError
from sim.recording.format import open_recording
from sim.tools.render_bench import draw_poses, measure_rendering
from tests.helpers.toy import QUICK, make_toy

ROWS = [
    Row("a", "lower is better", 1.0, "ms", 2.0, naive=8.0, note="naive: slow"),
    Row("b", "higher is better", 1.0, "/s", 2.0, True, note="naive: slow"),
    Row("c", "only shown", 1234.5, ""),
    Row("d", "later", None, "s", 1.0, note="on a GPU"),
]


def bench(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "deepgps.commands.main", "bench", *words]
    return subprocess.run(command, cwd=cwd, env=dict(os.environ), capture_output=True, text=True, check=False)


def make_positioner() -> NetworkPositioner:
    shape, settings = (6, 32, 3), NetworkSettings(width=16, layers=2)
    generator = torch.Generator().manual_seed(0)
    size = describe(np.zeros((1, *shape), np.uint8), 8).shape[1]
    features = Features(shape, 8, torch.randn(size, generator=generator), torch.randn((size, 5), generator=generator))
    network = make_network(settings, 5, 2, generator).eval()
    return NetworkPositioner(shape, features, settings, network, torch.zeros(2), torch.eye(2))


def images(count: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (count, 6, 32, 3), dtype=np.uint8)


@pytest.mark.slow
def test_a_small_bench_measures_everything(tmp_path: Path):
    done = bench("--tiny", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    written = json.loads((tmp_path / "bench.json").read_text())
    rows = {row["name"]: row for row in written["rows"]}
    measured = {
        *("train", "demo", "collect", "quick", "quick_rms", "spread", "spread_worst"),
        *("render", "render_plain", "render_rate", "latency", "rate", "memory", "step_ratio"),
        *("paper", "paper_rms"),
    }
    assert all(rows[name]["value"] > 0 for name in measured)
    assert all(row["verdict"] == "" for name, row in rows.items() if name in measured)
    assert written["git"] and written["cpu"] and written["date"]
    assert list((tmp_path / "runs" / "bench").iterdir()) == [], "a small bench is not kept, nor what it worked with"


def test_the_load_that_is_kept_is_that_before_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    load = [0.5, 0.0, 0.0]

    def measure(*_: object) -> tuple[list[Row], dict[str, str]]:
        load[0] = 9.0
        return [], {}

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "getloadavg", lambda: load)
    monkeypatch.setattr(benching, "measure", measure)
    benching.run_bench(benching.TINY, tmp_path / "bench.json", False, draw_poses, measure_rendering, ignore)
    assert json.loads((tmp_path / "bench.json").read_text())["load"] == 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--against", "nothing.json"], "bench nothing.json: no such file"),
        (["--against", "last"], "--against last: no earlier bench was kept in runs/bench"),
        (["--memory-samples", "5"], "--memory-samples 5: at least 8000, as many as the recording it repeats"),
        (["--memory-samples", "many"], "--memory-samples"),
        (["--fast"], "--fast"),
    ],
)
def test_wrong_words_give_one_clear_line(words: list[str], message: str, tmp_path: Path):
    done = bench(*words, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.rglob("*")) == []


def test_targets_are_met_or_missed():
    assert [row.verdict for row in ROWS] == ["met", "missed", "", "not measured"]


def test_values_are_written_to_three_digits():
    assert [write_value(value, "s") for value in (0.01234, 1.234, 123.4, 12345.0, 0.0)] == [
        *("0.0123 s", "1.23 s", "123 s", "12,345 s", "0.00 s")
    ]


def test_the_table_shows_figures_beside_targets_and_earlier_ones():
    console = Console(width=120, file=io.StringIO())
    with console.capture() as printed:
        console.print(tabulate(ROWS, {"a": 3.0}))
    line = printed.get().splitlines()[2]
    assert line.split() == [
        *["lower", "is", "better"],
        "1.00",
        "ms",
        "<=",
        "2.00",
        "ms",
        "met",
        "8.00",
        "ms",
        "3.00",
        "ms",
    ]
    assert list_notes(ROWS) == ["lower is better, higher is better: naive: slow", "later: on a GPU"]


def test_a_bench_is_compared_with_the_last_one_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bench_rows, "KEPT", tmp_path)
    for date, value in (("2026-01-01T1000", 1.0), ("2026-02-01T0900", 2.0)):
        write_bench(tmp_path / f"{date}-abc.json", [Row("a", "one", value, "s")], {"date": date})
    assert find_before("last") == {"a": 2.0}
    assert find_before(None) is None
    assert read_bench(tmp_path / "2026-01-01T1000-abc.json") == {"a": 1.0}


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 1}', '{"schema": 1, "rows": [{}]}'])
def test_a_file_that_is_no_bench_is_named(text: str, tmp_path: Path):
    (tmp_path / "other.json").write_text(text)
    with pytest.raises(InputError, match=r"other\.json is no bench: deepgps bench writes one"):
        read_bench(tmp_path / "other.json")


def test_a_bench_of_another_schema_is_refused(tmp_path: Path):
    (tmp_path / "old.json").write_text('{"schema": 0, "rows": []}')
    with pytest.raises(InputError, match="schema 0, but this version reads schema 2"):
        read_bench(tmp_path / "old.json")


@pytest.mark.parametrize("values", ["pixels", "ranks"])
def test_the_naive_way_finds_the_same_positions(values: PixelValues):
    positioner, seen = make_positioner(), images(7)
    assert positioner.features is not None
    positioner = replace(positioner, features=replace(positioner.features, values=values))
    ours, naive = positioner(seen), locate_naively(positioner, seen)
    assert np.abs(ours - naive).max() < 1e-4 * np.abs(naive).max()
    latency, rate = measure_speed(positioner, seen, 1)
    assert latency.value and rate.value and latency.naive and rate.naive


def test_spread_is_measured_from_each_places_mean():
    positioner, seen = make_positioner(), images(3)
    turned = np.stack([np.roll(seen, shift, axis=2) for shift in range(0, 32, 4)], axis=1)
    mixed = turned.copy()
    mixed[0, 0] = seen[1]
    size = np.abs(positioner(seen)).max()
    assert max(measure_spread(positioner, turned)) < 1e-3 * size
    rms, worst = measure_spread(positioner, mixed)
    apart = np.linalg.norm(positioner(seen[:1]) - positioner(seen[1:2]))
    assert worst == pytest.approx(7 / 8 * apart, rel=1e-2)
    assert rms == pytest.approx(np.sqrt(7 / 64 / 3) * apart, rel=1e-2)


def test_a_recording_is_repeated_as_new_segments(tmp_path: Path):
    source = make_toy(tmp_path / "toy", samples=300)
    length = len(source.observation)
    repeat_recording(source, 2 * length + 100, tmp_path / "long")
    long = open_recording(tmp_path / "long")
    assert np.array_equal(long.observation[length : 2 * length], source.observation)
    assert np.array_equal(long.observation[2 * length :], source.observation[:100])
    once, often = read_segments(source), read_segments(long)
    count = len(once.count)
    assert often.count[:count].equal(once.count) and often.count[count : 2 * count].equal(once.count)
    assert often.distance[count].equal(once.distance[0])
    assert int(often.index.max()) == 2 * length + 99


def test_the_memory_of_a_training_is_that_of_its_own_process(tmp_path: Path):
    source = make_toy(tmp_path / "toy", samples=300)
    settings = LearnSettings.model_validate({**QUICK, "train": {**QUICK["train"], "steps": 5}})
    assert measure_peak(Training(source.folder, tmp_path / "run", settings)) > 50e6
    assert (tmp_path / "run" / "deepgps" / "positioner.json").is_file()
    assert read_anonymous(os.getpid()) > 50e6
    assert read_anonymous(None) == 0


@pytest.mark.filterwarnings("ignore")
def test_a_training_that_fails_is_an_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    with pytest.raises(WorkError, match=r"the training on .*nowhere failed with code 1"):
        measure_peak(Training(tmp_path / "nowhere", tmp_path / "run", LearnSettings()))
    capfd.readouterr()
