"""Paths in the TUM format, which ``evo`` and most tools for trajectories read: time x y z qx qy qz qw."""

from pathlib import Path

import numpy as np

from sim.files.atomic import write_text

HEAD = "# deepgps: time_s x_m y_m z_m qx qy qz qw"


def write_tum(path: Path, time: np.ndarray, pose: np.ndarray) -> None:
    """Write a path; rows without a time or a position are left out.

    Args:
        path: The file to write.
        time: Times (n,) [s].
        pose: Poses x, y [m], yaw [rad] (n, 3), or positions (n, 2), written with a yaw of zero; as is a yaw of NaN.
    """
    place = np.asarray(pose, float)
    yaw = np.nan_to_num(place[:, 2]) if place.shape[1] > 2 else np.zeros(len(place))
    zero = np.zeros(len(place))
    table = np.column_stack([time, place[:, :2], zero, zero, zero, np.sin(yaw / 2.0), np.cos(yaw / 2.0)])
    kept = table[np.isfinite(table).all(axis=1)]
    lines = (" ".join([f"{row[0]:.6f}", *(f"{value:.9g}" for value in row[1:])]) for row in kept)
    write_text(path, "\n".join([HEAD, *lines]) + "\n")


def is_tum(data: bytes) -> bool:
    """Whether these are the contents of such a file, which may be written over."""
    return data.startswith(HEAD.encode())
