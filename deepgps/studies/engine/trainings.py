"""Share trainings that read no ticks among a study's runs: image features, and PoseNet, which learns from positions.

A finished training is left where the study's later runs find it, in a folder named by a hash of everything it has read.
Later runs take it as hard links, or as copies where links are impossible, so that each run is complete on its own. Runs
at the same time may both do the same training; on one machine, they produce the same bytes.
"""

import errno
import hashlib
import logging
import re
import secrets
from pathlib import Path

from deepgps.config.methods import METHODS
from deepgps.config.scenario import Scenario
from deepgps.learning.training_data import FEATURES, check_features, digest_features, has_features
from deepgps.methods.train import training_seed
from deepgps.positioner.stored_positioner import is_finished, load_positioner, read_training
from deepgps.runs.run_folder import FEATURE_FILES, TRAINED_FILES
from sim.errors import InputError
from sim.files.atomic import PART, link_file, list_files, remove_files
from sim.recording.derive import UNLEARNED_PREFIXES
from sim.recording.format import Recording, open_recording

log = logging.getLogger(__name__)
TRAINING_FILES = re.compile(f"{TRAINED_FILES}|{FEATURE_FILES}")  # Names of the files of a training or of features


def take_trainings(scenario: Scenario, run: Path) -> None:
    """Link into a run the trainings that other runs of its study have finished on the same data."""
    for name, shared in _find(scenario, run):
        if not _is_whole(run / name) and _is_sound(shared):
            remove_files(run / name, TRAINING_FILES)  # an interrupted training
            _link_folder(shared, run / name, shared.parent)


def leave_trainings(scenario: Scenario, run: Path) -> None:
    """Leave a run's finished trainings for other runs of its study."""
    for name, shared in _find(scenario, run):
        if _is_whole(run / name) and not _is_sound(shared):
            _link_folder(run / name, shared, shared.parent)


def digest_training(scenario: Scenario, method: str, recording: Recording) -> str:
    """Eight hexadecimal digits of everything that determines a training without ticks: settings, seed, images,
    positions, and the order of images along segments, by which features are chosen."""
    sums = {name: value for name, value in recording.manifest.sha256.items() if not name.startswith(UNLEARNED_PREFIXES)}
    read = f"{method} {training_seed(scenario)} {scenario.learn.model_dump_json()} {sorted(sums.items())}"
    return hashlib.sha256(read.encode() + recording.reading[:, :2].tobytes()).hexdigest()[:8]


def _find(scenario: Scenario, run: Path) -> list[tuple[str, Path]]:
    home, recording = run.parent.parent / "trainings", open_recording(run / "recording")
    features = digest_features(recording, scenario.learn, training_seed(scenario))[:8]
    shared = [method for method in scenario.methods if METHODS[method].map == "labels"]
    return [
        (FEATURES, home / features),
        *((method, home / digest_training(scenario, method, recording)) for method in shared),
    ]


def _is_whole(folder: Path) -> bool:
    return is_finished(folder) or has_features(folder)


def _is_sound(folder: Path) -> bool:
    """Whether a shared training is complete and intact; a damaged one is removed, so that it is made again."""
    if not _is_whole(folder):
        return False
    try:
        if has_features(folder):
            check_features(folder)
        else:
            load_positioner(folder)
            read_training(folder)
    except InputError as error:
        log.warning("%s; it is trained again", error)
        remove_files(folder, TRAINING_FILES)
        return False
    return True


def _link_folder(source: Path, target: Path, aside: Path) -> None:
    whole = aside / f"{target.name}.{secrets.randbelow(10**12)}{PART}"  # machines may share the folder
    remove_files(whole, TRAINING_FILES)
    for path in list_files(source, TRAINING_FILES):
        link_file(path, whole / path.name)
    try:
        whole.rename(target)
    except OSError as error:
        if error.errno not in {errno.ENOTEMPTY, errno.EEXIST}:  # another run was first
            raise
        remove_files(whole, TRAINING_FILES)
