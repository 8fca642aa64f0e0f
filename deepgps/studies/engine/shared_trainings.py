"""What runs of a study share whatever the encoders read: features are made from images, PoseNet learns from places too.

A finished training is left where the study's later runs find it, named by a hash of all that it has read. They take it
as hard links, or as copies where there can be none: each run is whole without the others. Runs that are at work
together may train the same, with the same bytes on the same machine.
"""

import errno
import hashlib
import logging
import os
import re
from pathlib import Path

from deepgps.data.features import check_features, has_features
from deepgps.learning.training_data import FEATURES, digest_features
from deepgps.methods.catalog import METHODS
from deepgps.methods.positioner import is_finished, load_positioner, read_training
from deepgps.run_folder import FEATURE_FILES, TRAINED_FILES
from deepgps.scenario import Scenario
from deepgps.stages import training_seed
from sim.errors import InputError
from sim.files import PART, link_file, list_files, remove_files
from sim.recording.derive import NOT_LEARNED
from sim.recording.format import Recording, open_recording

log = logging.getLogger(__name__)
TRAINED = re.compile(f"{TRAINED_FILES}|{FEATURE_FILES}")
"""Names of the files of a training, or of features."""


def take_trainings(scenario: Scenario, run: Path) -> None:
    """Give a run what others of its study have learned from the same."""
    for name, shared in _find(scenario, run):
        if not _is_whole(run / name) and _is_sound(shared):
            remove_files(run / name, TRAINED)  # a training that was cut off
            _link_folder(shared, run / name, shared.parent)


def leave_trainings(scenario: Scenario, run: Path) -> None:
    """Leave what a run has learned for others of its study."""
    for name, shared in _find(scenario, run):
        if _is_whole(run / name) and not _is_sound(shared):
            _link_folder(run / name, shared, shared.parent)


def digest_training(scenario: Scenario, method: str, recording: Recording) -> str:
    """Eight hexadecimal digits of all that decides a training without ticks: settings, seed, images, places, and which
    images follow one another, from which features are chosen."""
    sums = {name: value for name, value in recording.manifest.sha256.items() if not name.startswith(NOT_LEARNED)}
    read = f"{method} {training_seed(scenario)} {scenario.learn.model_dump_json()} {sorted(sums.items())}"
    return hashlib.sha256(read.encode() + recording.reading[:, :2].tobytes()).hexdigest()[:8]


def _find(scenario: Scenario, run: Path) -> list[tuple[str, Path]]:
    home, recording = run.parent.parent / "trainings", open_recording(run / "recording")
    features = digest_features(recording, scenario.learn, training_seed(scenario))[:8]
    shared = [method for method in scenario.methods if not METHODS[method].reads_ticks]
    return [
        (FEATURES, home / features),
        *((method, home / digest_training(scenario, method, recording)) for method in shared),
    ]


def _is_whole(folder: Path) -> bool:
    return is_finished(folder) or has_features(folder)


def _is_sound(folder: Path) -> bool:
    """Whether a shared training is whole; one that is damaged is removed, so that it is made again."""
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
        remove_files(folder, TRAINED)
        return False
    return True


def _link_folder(source: Path, target: Path, aside: Path) -> None:
    whole = aside / f"{target.name}.{os.getpid()}{PART}"
    remove_files(whole, TRAINED)
    for path in list_files(source, TRAINED):
        link_file(path, whole / path.name)
    try:
        whole.rename(target)
    except OSError as error:
        if error.errno not in {errno.ENOTEMPTY, errno.EEXIST}:  # another run was first
            raise
        remove_files(whole, TRAINED)
        whole.rmdir()
