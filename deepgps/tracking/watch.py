"""Causes of images as they come, by each image and those before it.

A camera that leans shows at turns only, and a frozen image by wheels that move: neither is known here.
"""

from collections import deque
from dataclasses import replace

import numpy as np

from deepgps.positioner.pose import locate_camera
from deepgps.tracking.causes import Monitor
from deepgps.tracking.rules import WINDOW, Seen, label


class Watch:
    """Remembers what the last images have shown."""

    def __init__(self, monitor: Monitor) -> None:
        self._monitor = monitor
        self._seen = deque[Seen](maxlen=WINDOW)

    def step(self, image: np.ndarray, novelty: float) -> str:
        """Name of the cause of the next polar image (rings, sectors, 3) with this novelty [m]; empty: none."""
        one, monitor = image[None], self._monitor
        compared = monitor.known.compare(one, locate_camera(monitor.positioner, one), monitor.upright)
        self._seen.append(monitor.look(one, np.array([False]), np.array([novelty]), compared))
        parts = {name: np.concatenate([vars(seen)[name] for seen in self._seen]) for name in vars(self._seen[-1])}
        found = monitor.weigh(Seen(**parts), False)
        if len(self._seen) < WINDOW:  # too few to be another room
            found = replace(found, long_new=np.zeros(len(self._seen), bool))
        return str(label(found)[-1])
