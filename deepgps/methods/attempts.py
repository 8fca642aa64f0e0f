"""Restarts: a training whose map is folded is repeated from other weights, until a map is not folded."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deepgps.initial_map.distances.folding import FoldScore
from deepgps.learning.checkpoint import NAME as CHECKPOINT
from deepgps.positioner.positioner import NetworkPositioner
from sim.files.atomic import remove_files, write_bytes

HISTORY = "history.npz"
FOLDER = re.compile(r"attempt\d+")
FILES = re.compile(rf"{re.escape(HISTORY)}|{re.escape(CHECKPOINT)}")


@dataclass(frozen=True)
class Attempt:
    """One training and its map.

    Attributes:
        number: Its number, counted from 0.
        positioner: The trained network.
        score: How far its map is folded.
        ambiguous: Observations that could be mirrored, as far as distances tell (N,) bool; none where turns tell.
        seconds: Duration of the training.
    """

    number: int
    positioner: NetworkPositioner
    score: FoldScore
    ambiguous: np.ndarray
    seconds: float


def train_until_unfolded(
    train_once: Callable[[int, Path], Attempt], restarts: int, folder: Path
) -> tuple[Attempt, list[Attempt]]:
    """Train until a map shows no fold or no restart is left, and keep the history of the least folded attempt.

    Args:
        train_once: (number of the attempt, its folder) -> attempt.
        restarts: Maximum number of trainings after the first one.
        folder: The method's folder, which gets the history of the attempt that is chosen.

    Returns:
        The least folded attempt, and all attempts.
    """
    attempts = []
    for number in range(restarts + 1):
        attempts.append(train_once(number, _folder_of(folder, number)))
        if not attempts[-1].score.folded:
            break
    best = min(range(len(attempts)), key=lambda number: attempts[number].score.worst)
    write_bytes(folder / HISTORY, (_folder_of(folder, best) / HISTORY).read_bytes())
    return attempts[best], attempts


def label_attempt(folder: Path, number: int) -> str:
    """Label of an attempt in progress reports: its method and the number of the restart."""
    method = folder.parent.name
    return method if number == 0 else f"{method}, restart {number}"


def remove_leftovers(folder: Path) -> None:
    """Remove the files of attempts and the checkpoint from a method's folder; a finished training needs neither."""
    for attempt in folder.glob("attempt*"):
        if FOLDER.fullmatch(attempt.name):
            remove_files(attempt, FILES)
    (folder / CHECKPOINT).unlink(missing_ok=True)


def _folder_of(folder: Path, number: int) -> Path:
    return folder / f"attempt{number}"
