"""Reading a study's folder: its table, and the other data that its recording shows."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pyarrow as pa
from pydantic import ValidationError

from deepgps.config.scenario import load_scenario, read_yaml
from deepgps.config.setting_problems import describe_problems
from deepgps.evaluation.error_field import ErrorField, read_all_headings
from deepgps.runs.run_folder import is_study
from deepgps.studies.catalog import REPORTS
from deepgps.studies.study import Study
from deepgps.studies.table import Row, read_rows, read_setting
from deepgps.viewer.save import hash_files
from deepgps.viewer.study.sliders import Step
from sim.errors import DamagedError, InputError
from sim.files.arrays import read_arrays
from sim.files.checksums import check_lines, check_sum
from sim.occupancy import FreeSpace
from sim.recording.format import open_truth
from sim.renamed import translate_study


def read_study(folder: Path) -> tuple[Study, list[Row]]:
    """Read a study and its table; raise InputError if the study is unfinished, broken, or has no finished run."""
    path = folder / "table.parquet"
    if not is_study(folder) or not path.is_file():
        lack = "table.parquet" if is_study(folder) else "study.yaml"
        raise InputError(f"{folder} is not a finished study: it has no {lack} (deepgps study writes it)")
    try:
        check_lines(folder / "study.yaml")
        check_sum(path)
    except DamagedError as error:
        raise DamagedError(f"{error}; run deepgps study with the same study and --out to write it again") from None
    try:
        study = Study.model_validate(translate_study(read_yaml(folder / "study.yaml")))
    except ValidationError as error:
        raise InputError(f"{folder / 'study.yaml'}: {describe_problems(error, Study)}") from None
    if REPORTS[study.report].gather:
        raise InputError(f"{folder} is a study without maps to view; its page is {folder / 'table.md'}")
    try:
        rows = read_rows(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None
    if not rows or not {"run", "recording", "seed", "samples", "method", "failure"} <= set(rows[0]):
        raise InputError(f"{path} is not a study's table")
    if not any(row["failure"] is None for row in rows):
        raise InputError(f"{folder} has no finished run; see its table.md for the reasons")
    return study, rows


def own_values(study: Study, names: Sequence[str]) -> dict[str, object]:
    """The scenario's own values of the settings that vary; empty if its file is gone or of another version."""
    with suppress(InputError, AttributeError):
        scenario = load_scenario(study.scenario, study.set)
        return {name: read_setting(scenario, name) for name in names}
    return {}


def open_space(folder: Path, row: Row) -> FreeSpace:
    return open_truth(folder / "runs" / row["run"] / "recording").free_space


def read_step(folder: Path, step: Step) -> dict[str, ErrorField]:
    return read_all_headings(folder / "runs" / step.rows[0]["run"])


def count_arrows(folder: Path, step: Step) -> int:
    """Number of arrows in the error fields of a step: one for each method and test position."""
    path = folder / "runs" / step.rows[0]["run"] / "error_field.npz"
    return len(step.rows) * len(read_arrays(path)["truth"])


def hash_study(folder: Path, rows: Sequence[Row]) -> str:
    """Thirty-two hexadecimal digits of a study's table, figures, error fields and recordings."""
    runs = dict.fromkeys(folder / "runs" / row["run"] for row in rows if row["failure"] is None)
    shown = [
        folder / "study.yaml",
        folder / "table.parquet",
        folder / "table.md",
        *sorted(folder.glob("figures/*.png")),
    ]
    shown += [run / name for name in ("error_field.npz", "recording/manifest.json") for run in runs]
    for path in shown:
        if not path.is_file():
            raise InputError(f"{folder} is an incomplete study: {path.relative_to(folder)} is missing")
    return hash_files(folder, shown)
