"""The reports of studies by name, one record each. The module imports nothing heavy, so reading a study is fast."""

from deepgps.studies.reports import changes, compare, diagnose, encoder, explore, maps, navigating, paper
from deepgps.studies.reports.record import StudyReport

REPORTS: dict[str, StudyReport] = {
    name: report
    for module in (compare, maps, changes, encoder, paper, diagnose, explore, navigating)
    for name, report in module.REPORTS.items()
}
PICTURES = tuple(sorted({name for report in REPORTS.values() for name in report.pictures}))
"""Names of all pictures that studies draw."""
