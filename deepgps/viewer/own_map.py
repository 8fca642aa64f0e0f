"""The map that a robot draws of its own while it drives, as far as a chunk of its drive tells."""

from collections.abc import Mapping

import numpy as np
import rerun as rr

from deepgps.viewer.scene import lift
from deepgps.viewer.stream import Rows, put

OWN_MAP = "world/drive/own_map"
PARTS = {"passed": (150, 200, 150), "unseen": (225, 110, 80), "frontiers": (250, 205, 60), "obstacles": (90, 90, 90)}
"""What the codes 1, 2, ... of its cells mean, and their colours."""
HEIGHT_M = 0.004


def log_own_map(stream: rr.RecordingStream, chunk: Mapping[str, np.ndarray], pose: np.ndarray, at: Rows) -> None:
    """Log the cells of a chunk's map, which puts its last observation where that truly has a pose (3,) [m, rad]."""
    (x, y, cell_m), own = chunk["view_at"], chunk["view_pose"]
    cos, sin = np.cos(pose[2] - own[2]), np.sin(pose[2] - own[2])
    for code, (name, colour) in enumerate(PARTS.items(), start=1):
        place = (x, y) + (np.argwhere(chunk["view"] == code)[:, ::-1] + 0.5) * cell_m - own[:2]
        world = pose[:2] + place @ np.array(((cos, sin), (-sin, cos)))
        put(stream, f"{OWN_MAP}/{name}", rr.Points3D(lift(world, HEIGHT_M), radii=[cell_m / 2], colors=[colour]), at)


def tell_unseen(chunk: Mapping[str, np.ndarray]) -> str:
    """What the map says in a sentence of the floor that no image is near; empty without a map."""
    if "view" not in chunk:
        return ""
    likely, low, high = (f"{100 * share:.1f}" for share in chunk["unseen"])
    return f"By the robot's own map {likely} % of the floor unseen ({low} to {high})."
