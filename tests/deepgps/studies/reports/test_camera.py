"""The study of camera faults: its report from made-up rows, and a small one for real, to its last file."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from deepgps.studies.catalog import REPORTS
from deepgps.studies.engine.engine import carry_out
from deepgps.studies.engine.shared_recordings import find_drives
from deepgps.studies.plan import plan_runs
from deepgps.studies.reports import camera
from deepgps.studies.reports.report import report_study, write_report
from deepgps.studies.study import load_study
from deepgps.studies.table import Row
from deepgps.terminal.progress import ignore
from sim.paths import STUDIES
from sim.recording.format import check_recording, open_recording, read_manifest
from sim.sensors.camera.faults import decode
from sim.settings import CameraMountSettings, DeploymentSettings, ImageFaultSettings
from tests.helpers.small_study import run_all_here

VARIED = ["image_faults.exposure", "deployment.light", "seed"]


def make_row(method: str, rms: float, seed: int, exposure: float = 1.0, light: float = 1.0) -> Row:
    errors = {"rms_m": rms, "median_m": rms / 2, "p95_m": 2 * rms, "max_m": 10 * rms}
    errors |= {"flipped": 0.2 if rms > 0.04 else 0.0, "fold_found": None if method == "posenet" else False}
    return {"method": method, "seed": seed, "image_faults.exposure": exposure, "deployment.light": light, **errors}


ROWS = [
    make_row("deepgps", 0.04, 0, light=0.5),
    make_row("deepgps", 0.01, 0),
    make_row("deepgps", 0.03, 1),
    make_row("deepgps", 0.03, 0, exposure=0.25),
    make_row("deepgps", 0.05, 1, exposure=0.25),
    make_row("posenet", 0.01, 0),
    make_row("posenet", 0.05, 0, light=0.5),
]


def cells(text: str, *first: str) -> list[str]:
    """The cells of the one line of a table that begins with these."""
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")]
    (line,) = [line for line in found if tuple(line[: len(first)]) == first]
    return line[len(first) :]


def test_each_fault_stands_beside_none_and_those_in_use_alone_come_last():
    table = camera.report(ROWS, VARIED)[0]
    assert cells(table, "no fault", "training and deployment", "DeepGPS")[:2] == ["2", "2.0 (1.00)"]
    assert cells(table, "exposure x 0.25", "training and deployment", "DeepGPS") == [
        *("2", "4.0 (2.00)", "2.0 (2.00)", "8.0 (2.00)", "40.0 (2.00)", "1", "0")
    ]
    assert cells(table, "all light x 0.5", "deployment only", "PoseNet")[1::4] == ["5.0 (5.00)", "1"]
    assert [fault.in_use for fault in camera.group_faults(ROWS, VARIED)] == [False, False, True]


def test_a_leaning_camera_with_another_fault_does_not_count_as_one_that_leans():
    lean = "camera_mount.roll_deg"
    rows = [
        {**make_row("deepgps_compass", rms, 0, exposure), lean: degrees}
        for rms, exposure, degrees in ((0.01, 1.0, 0.0), (0.02, 1.0, 8.0), (0.50, 0.25, 8.0), (0.50, 0.25, 2.0))
    ]
    figures = camera.measure(rows)
    assert figures["compass_tilted_8_ratio"].value == pytest.approx(2.0)
    assert "compass_tilted_2_ratio" not in figures


def test_the_worst_fault_of_each_kind_is_a_figure():
    figures = camera.measure(ROWS)
    assert set(figures) == {name for name in REPORTS["camera"].targets if not name.startswith("compass_")}
    values = {name: figure.value for name, figure in figures.items()}
    assert values == pytest.approx(
        {"clean_rms_m": 0.02}
        | {"both_rms_ratio": 2.0, "both_median_ratio": 2.0, "deployment_rms_ratio": 2.0, "deployment_median_ratio": 2.0}
    )


def test_a_leaning_camera_is_compared_with_a_level_one():
    leans = [("camera_mount", 2.0), ("camera_mount", 8.0), ("deployment.camera_mount", 2.0)]
    upright = {"camera_mount.roll_deg": 0.0, "deployment.camera_mount.roll_deg": None}
    level = {**make_row("deepgps_compass", 0.01, 0), **upright}
    rows = [
        level,
        *({**level, f"{where}.roll_deg": lean, "median_m": lean * level["median_m"]} for where, lean in leans),
    ]
    values = {name: figure.value for name, figure in camera.measure(rows).items() if name.startswith("compass_")}
    assert values == {"compass_tilted_2_ratio": 2.0, "compass_tilted_8_ratio": 8.0, "compass_knocked_2_ratio": 2.0}


def test_without_a_test_grid_nothing_is_folded():
    table = camera.report([{**row, "flipped": None} for row in ROWS], VARIED)[0]
    assert cells(table, "exposure x 0.25", "training and deployment", "DeepGPS")[-2:] == ["-", "0"]


def test_without_a_run_without_faults_there_is_nothing_to_compare_with():
    faulty = [row for row in ROWS if row["deployment.light"] != 1.0]
    assert camera.measure(faulty) == {}
    assert cells(camera.report(faulty, VARIED)[0], "all light x 0.5", "deployment only", "DeepGPS")[1] == "4.0"


def test_every_fault_of_the_settings_has_words_and_is_in_the_study():
    groups = {"image_faults": ImageFaultSettings, "camera_mount": CameraMountSettings, "deployment": DeploymentSettings}
    known = {f"{group}.{name}" for group, kind in groups.items() for name in kind.model_fields}
    in_use = {"deployment.drive_samples", "deployment.camera_mount"}
    assert known - set(camera.TITLES) == in_use
    cases = load_study("camera", tiny=False).cases
    changes = load_study("change", tiny=False).cases
    assert set(camera.TITLES) - {name for case in (*cases, *changes) for name in case} == {"camera_mount.pitch_deg"}
    assert all(len(case) <= 1 for case in cases)


def test_the_study_draws_nothing_again_for_faults_of_finished_images():
    plans = plan_runs(load_study("camera", tiny=False))
    drives = find_drives(plans)
    finished = [
        plan for plan in plans if not any(name.startswith(("camera_mount", "deployment")) for name in plan.varied)
    ]
    assert len({plan.recording for plan in finished}) == len(finished)
    assert len({drives[plan.recording].model_dump_json() for plan in finished}) == 2  # one a seed
    assert len({drive.model_dump_json() for drive in drives.values()}) == 2 + len(plans) - len(finished)


@pytest.mark.slow
def test_the_study_runs_to_its_picture(tmp_path: Path):
    values = yaml.safe_load((STUDIES / "camera.yaml").read_text())
    values["tiny"]["set"] |= {"drive.samples": 100}
    values["tiny"]["methods"] = ["knn"]  # which needs no training
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(values))
    study = load_study(str(tmp_path / "camera.yaml"), tiny=True)
    plans, folder = plan_runs(study), tmp_path / "study"
    assert carry_out(study, plans, folder, run_all=run_all_here, progress=ignore) == {}
    text = report_study(study, plans, {}, folder)
    assert "(1.00)" in cells(text, "no fault", "training and deployment", "Nearest neighbour")[1]
    report, origin = text.rsplit("\n\n", 1)
    assert report + "\n" == write_report(study, plans, {}, camera_rows(folder))
    assert origin.startswith("Made at ") and "torch" in origin
    assert (folder / "figures" / "camera.png").stat().st_size > 10_000
    clean, noisy, dim, knocked = (folder / "recordings" / plan.recording for plan in plans)
    assert read_manifest(noisy).model_dump()["derived_from"] == clean.name
    check_recording(noisy)
    np.testing.assert_array_equal(open_recording(clean).observation, open_recording(dim).observation)
    np.testing.assert_array_equal(open_recording(clean).observation, open_recording(knocked).observation)
    assert "knocked 8° to the right" in text and open_recording(knocked / "use").turns is not None
    light = [decode(open_recording(folder).test_observation).mean() for folder in (dim, clean)]
    assert light[0] == pytest.approx(0.5 * light[1], rel=0.2)


def camera_rows(folder: Path) -> list[Row]:
    import pyarrow.parquet as pq

    return pq.read_table(folder / "table.parquet").to_pylist()
