"""Trainings that encoders do not touch are done once in a study, and are what each run would have learned alone."""

from pathlib import Path

import pytest

from deepgps.learning.training_data import FEATURES, TABLE
from deepgps.methods.fit import fit_method
from deepgps.methods.train import training_seed
from deepgps.runs.run_folder import open_run
from deepgps.studies.engine.trainings import _link_folder
from deepgps.terminal.progress import ignore
from sim.recording.format import open_recording
from tests.helpers.small_study import do_here, write_study

FIRST_CASES = [{}, {"encoder.dropout": 0.3}]
LATER_CASES = [{"encoder.ticks_per_rev": 64}, {"encoder.step_noise": 0.1}, {"deployment.light": 0.5}]


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> dict[str, Path]:
    """Runs of a study, by what their encoders suffer from, or what has changed since they learned."""
    home = tmp_path_factory.mktemp("shared")
    cases = [*FIRST_CASES, *LATER_CASES]
    study = write_study(home, cases=cases, methods=["posenet", "dead_reckoned_labels"], report="plain", target={})
    assert do_here(study, home / "out") == {}
    found = {}
    for folder in (home / "out" / "runs").iterdir():
        scenario = open_run(folder)
        encoder = scenario.encoder
        kinds = {"lost": encoder.dropout, "ticks": encoder.ticks_per_rev == 64, "noise": encoder.step_noise}
        kinds["use"] = scenario.deployment.light < 1.0
        found[next((kind for kind, is_there in kinds.items() if is_there), "none")] = folder
    return found


def weights(run: Path, method: str) -> Path:
    return run / method / "weights.safetensors"


@pytest.mark.slow
def test_posenet_is_trained_once_for_all_encoders_that_lose_no_image_and_for_all_uses(runs):
    assert set(runs) == {"none", "lost", "ticks", "noise", "use"}
    for kind in ("ticks", "noise", "use"):
        assert weights(runs[kind], "posenet").samefile(weights(runs["none"], "posenet"))
    assert not weights(runs["lost"], "posenet").samefile(weights(runs["none"], "posenet"))


@pytest.mark.slow
def test_features_are_made_once_for_all_encoders_that_lose_no_image(runs):
    table = Path(FEATURES) / TABLE
    for kind in ("ticks", "noise", "use"):
        assert (runs[kind] / table).samefile(runs["none"] / table)
    assert not (runs["lost"] / table).samefile(runs["none"] / table)
    # features and PoseNet, of all images and of those that are not lost
    assert len(list((runs["none"].parent.parent / "trainings").iterdir())) == 4


@pytest.mark.slow
def test_a_method_that_reads_ticks_is_trained_for_each(runs):
    learned = {kind: weights(run, "dead_reckoned_labels").read_bytes() for kind, run in runs.items()}
    assert learned.pop("use") == learned["none"]
    assert len(set(learned.values())) == 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ticks", "lost"])
def test_what_is_shared_is_what_the_run_would_have_learned_alone(kind, runs, tmp_path):
    scenario, recording = open_run(runs[kind]), open_recording(runs[kind] / "recording")
    fit_method("posenet", recording, scenario.learn, training_seed(scenario), tmp_path / "posenet", ignore)
    for name in (weights(Path(), "posenet"), Path(FEATURES) / TABLE):
        assert (tmp_path / name).read_bytes() == (runs[kind] / name).read_bytes()


def test_of_two_runs_that_leave_the_same_training_at_once_the_second_finds_it_and_leaves_nothing(tmp_path):
    source, home = tmp_path / "run" / "posenet", tmp_path / "trainings"
    source.mkdir(parents=True)
    (source / "weights.safetensors").write_text("the same bytes")
    for _ in range(2):
        _link_folder(source, home / "0123abcd", home)
    assert [path.name for path in home.iterdir()] == ["0123abcd"]
    assert (home / "0123abcd" / "weights.safetensors").read_text() == "the same bytes"
