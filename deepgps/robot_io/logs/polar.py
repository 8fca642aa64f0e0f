"""The polar images of a log, drawn from its raw images one at a time into a file."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import IO

import numpy as np

from deepgps.robot_io.logs.camera import find_camera, prepare_unwrapping
from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.pictures import take_images
from deepgps.robot_io.logs.robot_config import CameraConfig
from deepgps.terminal.progress import Report
from sim.errors import InputError
from sim.sensors.camera.lens import Lens
from sim.sensors.camera.raw_camera import RawCamera, Unwrapping

FIRST = 20
"""Images of which most have the size of all; some cameras begin with another one."""


@dataclass
class PolarSource:
    """A log's images and what makes polar images of them.

    Attributes:
        log: The log.
        topic: Topic of the images.
        camera: Its calibration.
        unwrap: Makes polar images.
        lens: Lens of the polar images.
        damaged: Numbers of images that cannot be used, and why, as far as they have been read.
        drawn: Numbers of the images that have been read.
    """

    log: Log
    topic: str
    camera: RawCamera
    unwrap: Unwrapping
    lens: Lens
    damaged: dict[int, str] = field(default_factory=dict)
    drawn: set[int] = field(default_factory=set)

    @property
    def size(self) -> int:
        """Size of a polar image."""
        return self.unwrap.rings * self.unwrap.sectors * 3

    def draw(self, wanted: Sequence[int], store: IO[bytes], progress: Report, label: str) -> None:
        """Write the polar images of some images of the log to a file, in the order of ``wanted``."""
        places = dict[int, list[int]]()
        for place, number in enumerate(wanted):
            places.setdefault(number, []).append(place)
        self.drawn.update(places)
        store.truncate(len(wanted) * self.size)
        for done, (number, image) in enumerate(take_images(self.log, self.topic, places, self.damaged)):
            try:
                data = self.unwrap(image).tobytes()
            except InputError as error:
                self.damaged[number] = str(error)
                continue
            for place in places[number]:
                store.seek(place * self.size)
                store.write(data)
            progress(label, done + 1, len(places))
        store.flush()

    def map(self, store: IO[bytes], count: int) -> np.ndarray:
        """The polar images in a file (n, rings, sectors, 3), memory-mapped."""
        shape = (count, self.unwrap.rings, self.unwrap.sectors, 3)
        return np.memmap(store, np.uint8, "c", shape=shape) if count else np.empty(shape, np.uint8)


def open_polar(log: Log, config: CameraConfig) -> PolarSource:
    """Find the calibration, for the size of most of the first images that can be decoded.

    Raises:
        InputError: There is no such image, or no calibration for it.
    """
    problems = dict[int, str]()
    sizes = Counter(
        (image.shape[1], image.shape[0]) for _, image in take_images(log, config.topic, range(FIRST), problems)
    )
    if not sizes:
        why = next(iter(problems.values()), "there is none")
        raise InputError(f"camera.topic {config.topic}: none of the first images can be used: {why}")
    camera = find_camera(log, config, sizes.most_common(1)[0][0])
    unwrap, lens = prepare_unwrapping(camera, config)
    return PolarSource(log, config.topic, camera, unwrap, lens)
