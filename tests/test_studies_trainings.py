"""Trainings that encoders do not touch are done once in a study, and are what each run would have learned alone."""

from pathlib import Path

import pytest
from small_study import finish, start, write_study

from deepgps.methods import METHODS
from deepgps.progress import ignore
from deepgps.run import open_run, training_seed
from sim.records import open_recording

FIRST = [{}, {"encoder.lost": 0.3}]
LATER = [{"encoder.ticks_per_rev": 64}, {"encoder.gap_noise": 0.1}]


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[str, Path]:
    """Runs of a study that has grown, by what its encoders suffer from."""
    home = tmp_path_factory.mktemp("shared")
    for cases in (FIRST, [*FIRST, *LATER]):
        study = write_study(home, cases=cases, methods=["posenet", "odometry"], report="plain", target={})
        finish(start(study, home / "out"))
    found = {}
    for folder in (home / "out" / "runs").iterdir():
        encoder = open_run(folder).encoder
        kinds = {"lost": encoder.lost, "ticks": encoder.ticks_per_rev == 64, "noise": encoder.gap_noise}
        found[next((kind for kind, is_there in kinds.items() if is_there), "none")] = folder
    return found


def weights(run: Path, method: str) -> Path:
    return run / method / "weights.safetensors"


@pytest.mark.slow
def test_posenet_is_trained_once_for_all_encoders_that_lose_no_image(runs):
    assert set(runs) == {"none", "lost", "ticks", "noise"}
    assert weights(runs["ticks"], "posenet").samefile(weights(runs["none"], "posenet"))
    assert weights(runs["noise"], "posenet").samefile(weights(runs["none"], "posenet"))
    assert not weights(runs["lost"], "posenet").samefile(weights(runs["none"], "posenet"))
    assert len(list((runs["none"].parent.parent / "trainings").iterdir())) == 2


@pytest.mark.slow
def test_a_method_that_reads_ticks_is_trained_for_each(runs):
    learned = {weights(run, "odometry").read_bytes() for run in runs.values()}
    assert len(learned) == 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ticks", "lost"])
def test_what_is_shared_is_what_the_run_would_have_learned_alone(kind, runs, tmp_path):
    scenario, recording = open_run(runs[kind]), open_recording(runs[kind] / "recording")
    METHODS["posenet"](recording, scenario.learn, training_seed(scenario), tmp_path / "posenet", ignore)
    assert weights(tmp_path, "posenet").read_bytes() == weights(runs[kind], "posenet").read_bytes()
