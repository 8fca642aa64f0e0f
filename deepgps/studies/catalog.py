"""The reports of studies by name, one record each. The module imports nothing heavy, so reading a study is fast."""

from deepgps.studies.reports import changes, compare, diagnose, encoder, navigating, paper, worlds
from deepgps.studies.reports.record import StudyReport

REPORTS: dict[str, StudyReport] = {
    name: report
    for module in (compare, changes, encoder, paper, worlds, diagnose, navigating)
    for name, report in module.REPORTS.items()
}
PICTURES = tuple(sorted({name for report in REPORTS.values() for name in report.pictures}))
"""Names of all pictures that studies draw."""
