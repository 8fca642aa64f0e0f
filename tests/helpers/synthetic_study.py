"""A small made-up study folder in the real formats: two rooms, three noises, two seeds; errors grow with the noise."""

from pathlib import Path

import numpy as np

from deepgps.config.scenario import write_out as write_scenario
from deepgps.studies.plan import Plan, plan_runs
from deepgps.studies.reports.report import report_study
from deepgps.studies.study import Study, write_out
from sim.files.checksums import write_arrays, write_json, write_lines
from sim.geometry import FreeSpace, save_free_space
from sim.recording.format import write_files
from tests.helpers.synthetic_run import make_free_space, make_grid, make_metrics, make_predictions

NOISES = (0.0, 0.1, 0.3)
ROOMS = (1, 2)
METHODS = ("deepgps", "posenet")
STUDY = Study.model_validate(
    {
        "name": "made_up",
        "scenario": "living_room",
        "methods": METHODS,
        "cases": [{"room.seed": room} for room in ROOMS],
        "axes": {"encoder.step_noise": NOISES},
        "seeds": [0, 1],
        "report": "curves",
    }
)


def write_synthetic_study(folder: Path, study: Study = STUDY, failed: tuple[int, ...] = ()) -> list[Plan]:
    """Write a study folder whose runs are made up; those of these numbers failed. Returns the runs."""
    plans = plan_runs(study)
    failures = {plans[number].run: "it did not want to" for number in failed}
    for plan in plans:
        if plan.run not in failures:
            write_synthetic_outcome(folder, plan)
    write_lines(folder / "study.yaml", write_out(study))
    report_study(study, plans, failures, folder)
    return plans


def write_synthetic_outcome(folder: Path, plan: Plan) -> None:
    """Write what one run leaves and a viewer shows: its recording's truth, its error field, its metrics."""
    noise, room, seed = plan.scenario.encoder.step_noise, plan.scenario.room.seed, plan.scenario.seed
    run, recording, space = folder / "runs" / plan.run, folder / "recordings" / plan.recording, make_room(room)
    test_pose = make_grid(make_free_space(), spacing_m=0.5)
    size = {"deepgps": 0.01 + noise, "posenet": 0.01}
    predictions = {
        method: room * make_predictions(test_pose, size[method], 1e-6, np.random.default_rng(seed))
        for method in METHODS
    }
    test_pose[..., :2] *= room
    save_free_space(recording / "truth" / "free_space.npz", space)
    poses = {"truth/pose.npy": np.zeros((2, 3)), "truth/test_pose.npy": test_pose}
    readings = {"truth/reading.npy": np.zeros((2, 2), int), "truth/wheel_angle.npy": np.zeros((2, 2))}
    write_files(recording, {**poses, **readings}, {})
    truth, heading = test_pose[:, 0, :2], test_pose[0, :, 2]
    write_arrays(run / "error_field.npz", {"truth": truth, "heading": heading, **predictions})
    metrics = make_metrics(truth, predictions, samples=200)
    write_json(run / "metrics.json", {**metrics, "scenario": plan.scenario.name, "seed": seed})
    write_lines(run / "scenario.yaml", write_scenario(plan.scenario))
    (run / "recording").symlink_to(Path("..") / ".." / "recordings" / plan.recording)


def make_room(size: int) -> FreeSpace:
    """The made-up room, so many times as large."""
    space = make_free_space()
    return FreeSpace(
        size * space.origin, size * space.cell_m, space.free, space.reachable, space.start, size * space.shorter_side_m
    )
