"""Features of images are made once in a study, and are what each run would have made alone."""

from pathlib import Path

import pytest

from deepgps.learning.training_data import FEATURES, TABLE
from deepgps.methods.fit import fit_method
from deepgps.methods.train import training_seed
from deepgps.runs.run_folder import open_run
from deepgps.terminal.progress import ignore
from sim.recording.format import open_recording
from tests.helpers.small_study import do_here, write_study

CASES = [{}, {"encoder.ticks_per_rev": 64}, {"deployment.light": 0.5}, {"encoder.dropout": 0.3}]


@pytest.mark.slow
def test_features_are_made_once_for_all_runs_on_the_same_images(tmp_path: Path) -> None:
    study, table = (
        write_study(tmp_path, cases=CASES, methods=["knn"], report="plain", target={}),
        Path(FEATURES) / TABLE,
    )
    assert do_here(study, tmp_path / "out") == {}
    runs = list((tmp_path / "out" / "runs").iterdir())
    lost = next(run for run in runs if open_run(run).encoder.dropout)
    others = [run / table for run in runs if run != lost]
    assert all(other.samefile(others[0]) for other in others) and not (lost / table).samefile(others[0])
    assert len(list((tmp_path / "out" / FEATURES).iterdir())) == 2
    for run in (lost, others[0].parents[1]):
        scenario, recording, alone = open_run(run), open_recording(run / "recording"), tmp_path / run.name
        fit_method("knn", recording, scenario.learn, training_seed(scenario), alone / "knn", ignore)
        assert (alone / table).read_bytes() == (run / table).read_bytes()
