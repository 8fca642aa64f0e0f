"""Causes of images as they come, by each image and those before it. A lean shows at turns only, which are not known."""

from collections import deque
from dataclasses import replace

import numpy as np

from deepgps.methods.pose import locate_camera
from deepgps.methods.positioner import NetworkPositioner
from deepgps.monitoring.causes import Monitor, weigh
from deepgps.monitoring.rules import WINDOW, Seen, label


class Watch:
    """Remembers what the last images have shown."""

    def __init__(self, monitor: Monitor) -> None:
        self._monitor = monitor
        self._seen = deque[Seen](maxlen=WINDOW)

    def step(self, image: np.ndarray, accepted: bool) -> str:
        """Name of the cause of the next polar image (rings, sectors, 3), empty: none; ``accepted`` by the method."""
        one, positioner = image[None], self._monitor.positioner
        upright = positioner.upright if isinstance(positioner, NetworkPositioner) else self._monitor.upright
        compared = self._monitor.known.compare(one, locate_camera(positioner, one), upright)
        self._seen.append(self._monitor.look(one, np.array([False]), np.array([accepted]), compared))
        parts = {name: np.concatenate([vars(seen)[name] for seen in self._seen]) for name in vars(self._seen[-1])}
        found = weigh(Seen(**parts), self._monitor.known.usual_match, False)
        if len(self._seen) < WINDOW:  # too few to be another room
            found = replace(found, long_new=np.zeros(len(self._seen), bool))
        return str(label(found)[-1])
