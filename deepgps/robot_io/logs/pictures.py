"""The images of a log: their times, and those that are wanted, decoded one at a time."""

from array import array
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import numpy as np

from deepgps.robot_io.logs.containers import Log
from deepgps.robot_io.logs.images import COMPRESSED, RAW, decoder
from deepgps.robot_io.logs.sample import Part, Sample
from sim.errors import InputError

KINDS = (RAW, COMPRESSED)


@dataclass
class ImageList:
    """Times of a topic's images, in the order in which they were logged.

    Attributes:
        topic: The topic.
        log_ns: When each was logged (n,) [ns].
        stamp_ns: Its stamp (n,) [ns]; 0: none.
    """

    topic: str
    log_ns: array = field(default_factory=lambda: array("q"))
    stamp_ns: array = field(default_factory=lambda: array("q"))

    def take(self, sample: Sample, part: Part) -> None:
        """Note the times of an image, without decoding it."""
        self.log_ns.append(sample.log_ns)
        self.stamp_ns.append(sample.stamp_ns)

    def check(self) -> None:
        """Raise InputError if there is no image."""
        if not self.log_ns:
            raise InputError(f"camera.topic {self.topic} holds no image")


def open_images(log: Log, topic: str) -> ImageList:
    """Prepare to list a topic's images; raises InputError if there is no such topic."""
    log.check_topic(topic, "camera.topic", KINDS)
    return ImageList(topic)


def take_images(
    log: Log, topic: str, wanted: Collection[int], damaged: dict[int, str]
) -> Iterator[tuple[int, np.ndarray]]:
    """Number and pixels (height, width, 3) uint8 RGB of some images of a topic.

    Args:
        log: The log.
        topic: The topic.
        wanted: Numbers of the images.
        damaged: Receives, by its number, why an image cannot be decoded.
    """
    decode = decoder(log.types[topic])
    last = max(wanted, default=-1)
    for number, (sample, part) in enumerate(log.read([topic])):
        if number > last:
            return
        if number in wanted:
            try:
                image = decode(part.decode(sample))
            except InputError as error:
                damaged[number] = str(error)
                continue
            yield number, image
