"""The figures of strategies: end-point against dense, at equal distances travelled and at equal numbers of images."""

from collections.abc import Sequence

from deepgps.reports.targets import Figure
from deepgps.studies.table import Row, mean

STRATEGY, SAMPLES = "drive.strategy", "drive.samples"


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """Ratios of the end-point strategy to the dense one: RMS of DeepGPS, and distance travelled."""
    rows = [row for row in rows if row["method"] == "deepgps"]
    dense = [row for row in rows if row[STRATEGY] == "dense"]
    wanted = {row[SAMPLES] for row in dense}
    same = [row for row in rows if row[STRATEGY] == "endpoint" and row[SAMPLES] in wanted]
    fewer = [row for row in rows if row[STRATEGY] == "endpoint" and row[SAMPLES] not in wanted]
    figures = {}
    if dense and fewer:
        figures["travel_ratio"] = _compare("RMS, end-point / dense, equal travel", fewer, dense, "rms_m")
    if dense and same:
        figures["samples_ratio"] = _compare("RMS, end-point / dense, equal images", same, dense, "rms_m")
        figures["way_ratio"] = _compare("travel, end-point / dense, equal images", same, dense, "distance_m")
    return figures


def _compare(title: str, rows: Sequence[Row], others: Sequence[Row], name: str) -> Figure:
    return Figure(title, mean(rows, name) / mean(others, name), "", at_least=True)
