"""The report of encoders from made-up rows, and the study run small."""

import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from deepgps.studies.encoder import choose_encoders, draw, find_pairs, find_sweeps, measure, report
from deepgps.studies.recordings import find_drives
from deepgps.studies.study import FIGURES, load_study, plan_runs
from deepgps.studies.table import Row
from deepgps.style import to_png
from sim.settings import EncoderSettings

NAMES = ("ticks_per_rev", "gap_noise", "radius_error_left", "radius_error_right")
PERFECT = EncoderSettings()


def make_rows(rms: dict[tuple[tuple[str, float], ...], float]) -> list[Row]:
    """Two seeds of two methods for each set of faults; the noise-aware one is half as wrong."""
    rows = []
    for faults, error in rms.items():
        settings = {f"encoder.{name}": dict(faults).get(name, getattr(PERFECT, name)) for name in NAMES}
        for method, share in (("deepgps", 1.0), ("deepgps_aware", 0.5)):
            for seed in (0, 1):
                row = {"run": "r", "seed": seed, **settings, "samples": 100, "method": method, "scale": 1.0}
                row |= {"rms_m": share * error * (1 + 0.1 * seed), "failure": None}
                row |= {"segment_rms_m": error, "segment_expected_m": error, "wrong_doubted": 3, "segments_wrong": 4}
                rows.append(row)
    return rows


ROWS = make_rows(
    {
        (): 0.01,
        (("ticks_per_rev", 64),): 0.0105,
        (("ticks_per_rev", 16),): 0.011,
        (("ticks_per_rev", 4),): 0.03,
        (("gap_noise", 0.1),): 0.025,
        (("radius_error_left", 0.02), ("radius_error_right", 0.02)): 0.04,
        (("radius_error_left", 0.02),): 0.02,
        (("gap_noise", 0.1), ("ticks_per_rev", 4)): 0.05,
    }
)


def test_faults_are_told_apart_from_pairs_of_them():
    found = {sweep.names: list(sweep.by_value("deepgps")) for sweep in find_sweeps(ROWS)}
    assert found == {
        ("ticks_per_rev",): [4096, 64, 16, 4],
        ("gap_noise",): [0.0, 0.1],
        ("radius_error_left",): [0.0, 0.02],
        ("radius_error_left", "radius_error_right"): [0.0, 0.02],
    }
    assert find_pairs(ROWS) == [("gap_noise", "ticks_per_rev")]


def test_faults_of_either_sign_grow_from_none():
    sweep = find_sweeps(make_rows({(("radius_error_left", error),): 0.01 for error in (-0.1, 0.0, 0.02)}))[0]
    assert list(sweep.by_value("deepgps")) == [0.0, 0.02, -0.1]


def test_the_page_says_which_encoder_is_enough():
    heads, lines = choose_encoders(find_sweeps(ROWS), ["deepgps", "deepgps_aware"])
    assert heads == ["fault", "DeepGPS", "DeepGPS, noise-aware"]
    assert lines[0] == ["ticks per revolution", "16", "all, to 4"]
    assert lines[1] == ["noise w of each gap", "0, no more", "all, to 0.1"]
    missed_a_nook = [{**row, "seed": 2, "rms_m": 1.0} for row in ROWS if row["seed"] == 0]
    assert choose_encoders(find_sweeps([*ROWS, *missed_a_nook]), ["deepgps", "deepgps_aware"])[1] == lines
    worse = find_sweeps([{**row, "rms_m": row["rms_m"] + 0.1} for row in ROWS])
    assert {cell for line in choose_encoders(worse, ["deepgps"])[1] for cell in line[1:]} == {"none is enough"}


def test_every_fault_and_pair_has_a_table():
    text = "\n".join(report(ROWS, []))
    for title in (
        "## Ticks per revolution",
        "## Error of both wheels' radius",
        "## Noise w of each gap with ticks per",
    ):
        assert title in text
    ticks = text.split("## Ticks per revolution")[1].split("##")[0].splitlines()
    (line,) = [line for line in ticks if line.startswith("|") and line.split("|")[1].strip() == "4"]
    cells = [cell.strip() for cell in line.split("|")[1:-1]]
    assert cells == ["4", "3.00", "3.00", "3.1 (3.0 to 3.3), 3.00", "1.6 (1.5 to 1.7), 3.00", "1.0000", "3 / 4"]


def test_targets_are_ratios_to_a_perfect_encoder():
    figures = measure(ROWS)
    assert set(figures) == set(FIGURES["encoder"])
    assert figures["rms_w"].value == pytest.approx(0.025 * 1.05)
    assert figures["aware_rms_w"].worst == pytest.approx(0.0125 * 1.1)
    assert figures["ticks_16"].value == pytest.approx(1.1)
    assert figures["ticks_4"].value == figures["aware_ticks_4"].value == pytest.approx(3.0)


def test_each_fault_is_a_panel_with_a_band_and_theory():
    picture = draw(ROWS, [], Path())
    assert [axes.get_xlabel() for axes in picture.axes] == [sweep.title for sweep in find_sweeps(ROWS)]
    labels = {str(line.get_label()) for line in picture.axes[0].lines}
    assert {"DeepGPS", "DeepGPS, noise-aware", "one segment, theory", "one segment, measured"} == labels
    assert len(picture.axes[0].collections) == 2
    assert to_png(picture).startswith(b"\x89PNG")


def test_the_study_asks_of_every_fault_with_five_seeds_and_shares_five_drives():
    plans = plan_runs(load_study("encoder", tiny=False))
    asked = {name for plan in plans for name in EncoderSettings.model_fields if name in str(dict(plan.varied))}
    assert asked == set(EncoderSettings.model_fields) - {"rounding"}
    assert len({plan.scenario.seed for plan in plans}) == 5
    assert len({drive.model_dump_json() for drive in find_drives(plans).values()}) == 5
    assert {tuple(plan.scenario.methods) for plan in plans} == {
        ("deepgps", "deepgps_aware", "deepgps_turns", "odometry", "posenet")
    }


@pytest.mark.slow
def test_the_study_runs_small(tmp_path: Path):
    command = [sys.executable, "-m", "deepgps.cli", "study", "encoder", "--tiny", "--out", "study"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    rows = pq.read_table(tmp_path / "study" / "table.parquet").to_pylist()
    assert len(rows) == 5 * 3 and not any(row["failure"] for row in rows)
    noisy = [row for row in rows if row["encoder.gap_noise"] == 0.1]
    assert all(row["segment_rms_m"] > 10 * rows[0]["segment_rms_m"] for row in noisy)
    recordings = {row["recording"] for row in rows}
    manifests = [(tmp_path / "study" / "recordings" / name / "manifest.json").read_text() for name in recordings]
    assert sum("derived_from" in text for text in manifests) == len(manifests) - 1  # driven once
    assert (tmp_path / "study" / "figures" / "encoder.png").stat().st_size > 10_000
    assert "Which encoder keeps the RMS at 2 cm" in (tmp_path / "study" / "table.md").read_text()
