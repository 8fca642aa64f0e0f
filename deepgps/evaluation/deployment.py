"""The deployment drive: its camera's lean, for methods that correct it, errors on its images, and causes of these."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from deepgps.data.turns import adapt_upright, describe_lean
from deepgps.evaluation.error_field import ErrorField
from deepgps.evaluation.measures import make_field
from deepgps.positioner.pose import find_poses
from deepgps.positioner.positioner import FeaturePositioner, Positioner
from deepgps.tracking.causes import name_causes
from sim.alignment import Alignment
from sim.errors import WorkError
from sim.recording.format import DEPLOYMENT_MANIFEST, Recording, open_recording, open_truth
from sim.recording.manifest import DEPLOYMENT_FOLDER


def open_deployment(recording: Recording) -> Recording | None:
    """The recording of the deployment drive; None if there is none."""
    if DEPLOYMENT_MANIFEST not in recording.manifest.sha256:
        return None
    return open_recording(recording.folder / DEPLOYMENT_FOLDER)


def adapt(positioner: Positioner, drive: Recording | None) -> tuple[Positioner, dict[str, float]]:
    """A positioner for images in deployment, which corrects the camera's lean by the deployment drive if it has one.

    Also returns the lean in deployment for ``metrics.json``, which only methods have that correct it.
    """
    if drive is None or not isinstance(positioner, FeaturePositioner) or positioner.upright is None:
        return positioner, {}
    upright, measured = adapt_upright(positioner.upright, drive)
    return replace(positioner, upright=upright), {} if measured is None else describe_lean(measured)


def measure_deployment(positioner: Positioner, alignment: Alignment, drive: Recording, folder: Path) -> ErrorField:
    """Error field of a method, in a folder, on the images of the deployment drive, each at a place of its own.

    Raises WorkError if the method predicts no position.
    """
    found = find_poses(positioner, drive.observation)
    check_predicted(folder, found.position, "observations in deployment")
    return make_field(found, open_truth(drive.folder).pose[:, None], alignment)


def check_predicted(folder: Path, position: np.ndarray, what: str = "observations") -> None:
    """Raise WorkError where the method of a folder predicts no position of these (n, 2)."""
    if wrong := int((~np.isfinite(position)).any(axis=1).sum()):
        raise WorkError(f"{folder}: for {wrong} of {len(position)} {what} it predicts no position")


def find_causes(positioner: Positioner, recording: Recording, drive: Recording) -> dict[str, Any]:
    """Why images of a deployment drive are refused, for the figures; nothing where ``name_causes`` knows nothing."""
    causes = name_causes(positioner, recording, drive)
    return {} if causes is None else {"causes": causes.summarise()}
