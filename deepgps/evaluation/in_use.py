"""The drive in use: the camera's lean in it, for methods that correct it, and their errors on its images."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.alignment import Alignment
from deepgps.data.lean import adapt_upright, describe_lean
from deepgps.data.plausible_readings import keep_plausible
from deepgps.methods.positioner import NetworkPositioner, Positioner
from sim.errors import InputError, WorkError
from sim.recording.format import OF_USE, Recording, open_recording, open_truth
from sim.recording.in_use import FOLDER as IN_USE


def open_drive_in_use(recording: Recording) -> Recording | None:
    """The recording of the drive in use with its plausible readings; None if there is none."""
    if OF_USE not in recording.manifest.sha256:
        return None
    return keep_plausible(open_recording(recording.folder / IN_USE))


def adapt(positioner: Positioner, drive: Recording | None) -> tuple[Positioner, dict[str, float]]:
    """A positioner for images in use: its correction of the camera's lean is that of the drive in use, if it has one.

    Args:
        positioner: As trained.
        drive: The drive in use; None: the camera is taken to lean as in training.

    Returns:
        The positioner in use, and the lean in use for ``metrics.json``, which only methods have that correct it.
    """
    if drive is None or not isinstance(positioner, NetworkPositioner) or positioner.upright is None:
        return positioner, {}
    upright, lean = adapt_upright(positioner.upright, drive)
    return replace(positioner, upright=upright), {} if lean is None else describe_lean(lean)


def measure_in_use(positioner: Positioner, alignment: Alignment, drive: Recording, folder: Path) -> dict[str, Any]:
    """RMS and median error [m] of the positions of all images of the drive in use, against its truth.

    Args:
        positioner: The positioner in use.
        alignment: From its frame to the world's, fitted on training samples.
        drive: The drive in use.
        folder: The method's folder, for messages.

    Raises:
        InputError: Its truth has another number of poses.
        WorkError: The method predicts no position.
    """
    pose, found = open_truth(drive.folder).pose, positioner(drive.observation)
    if len(pose) != len(found):
        raise InputError(f"{drive.folder}: it has {len(found)} observations, but the truth {len(pose)} poses")
    if wrong := int((~np.isfinite(found)).any(axis=1).sum()):
        raise WorkError(f"{folder}: for {wrong} of {len(found)} observations in use it predicts no position")
    error = np.linalg.norm(alignment.apply(found) - pose[:, :2], axis=1)
    return {
        "rms_m": float(np.sqrt(np.mean(error**2))),
        "median_m": float(np.median(error)),
        "max_m": float(error.max()),
    }
