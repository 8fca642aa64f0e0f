"""AprilTags of the family 36h11 (Olson 2011): their images, their corners, and their detection in grey images.

A tag's frame has its origin in the middle of its black square, x to the right and y up as seen by a reader, z towards
the reader. Its corners go clockwise from the upper left, as seen by a reader and as OpenCV returns them.
"""

from dataclasses import dataclass

import cv2
import numpy as np

TAGS = 82  # Number of tags in the paper's room (Sec. IV-C): numbers 0 to 81 of the family
SIDE_M = 0.16  # Side of the black square [m]
MODULES = 8  # Modules across the black square: a border of one on each side and six of code
PLATE_M = SIDE_M * (MODULES + 2) / MODULES
"""Side of the white plate, which has a margin of one module around the black square [m]."""
CORNERS = SIDE_M / 2 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
"""Corners of the black square in the tag's frame (4, 3) [m]."""
EDGE_POINTS, EDGE_SPAN = 12, (0.12, 0.88)
"""Points on a side at which its edge is searched, and the part of the side that they cover."""
EDGE_SAMPLES, REACH_PX, ROUNDS = 13, (1.5, 4.0), 2
"""Samples across an edge, least and greatest reach to either side [px], and number of line fits."""
_FAMILY = cv2.aruco.DICT_APRILTAG_36h11
_MODULE_PX = 16


@dataclass(frozen=True)
class Detections:
    """Tags found in images."""

    view: np.ndarray  # Image in which each tag was found (S,) int64
    tag: np.ndarray  # Number of each tag (S,) int64
    corner: np.ndarray  # Columns and rows of each tag's corners (S, 4, 2) [px], pixel centres at integers

    def of(self, chosen: np.ndarray) -> "Detections":
        """Return the detections that an index or a mask selects."""
        return Detections(self.view[chosen], self.tag[chosen], self.corner[chosen])


def measure_size(detections: Detections) -> np.ndarray:
    """Return the root of each tag's area (S,) [px]."""
    across = detections.corner[:, 2] - detections.corner[:, 0]
    down = detections.corner[:, 3] - detections.corner[:, 1]
    return np.sqrt(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]) / 2)


def draw_tag(number: int) -> np.ndarray:
    """Return an image of a complete plate (160, 160, 3) uint8, with a power of two of pixels per module."""
    family = cv2.aruco.getPredefinedDictionary(_FAMILY)
    code = cv2.aruco.generateImageMarker(family, number, MODULES * _MODULE_PX)
    plate = np.pad(code, _MODULE_PX, constant_values=255)
    return np.repeat(plate[..., None], 3, axis=2)


def find_tags(images: np.ndarray) -> Detections:
    """Find tags in images (N, rows, columns) uint8; views are numbered like the images."""
    detector = make_detector()
    view, tag, corner = [], [], []
    for number, image in enumerate(images):
        corners, numbers, _ = detector.detectMarkers(image)
        if numbers is not None:
            view.append(np.full(len(numbers), number))
            tag.append(numbers.ravel())
            corner.append(refine(image, np.concatenate(corners).astype(float)))
    if not view:
        return Detections(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 4, 2)))
    return Detections(np.concatenate(view), np.concatenate(tag).astype(np.int64), np.concatenate(corner))


def refine(image: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Refine corners (n, 4, 2) [px] to the intersections of lines along the black squares' edges (Wang and Olson 2016).

    OpenCV's own corner search places a blurred corner a quarter of a pixel too far inside; blur does not move edges.
    """
    for _ in range(ROUNDS):
        along = np.roll(corner, -1, axis=1) - corner
        side = np.linalg.norm(along, axis=2, keepdims=True)
        out = np.stack([along[..., 1], -along[..., 0]], axis=2) / side
        reach = np.clip(side / MODULES, *REACH_PX)
        point = corner[:, :, None] + np.linspace(*EDGE_SPAN, EDGE_POINTS)[:, None] * along[:, :, None]
        offset = np.linspace(-1.0, 1.0, EDGE_SAMPLES) * reach
        place = (point[:, :, :, None] + offset[:, :, None, :, None] * out[:, :, None, None]).astype(np.float32)
        flat = place.reshape(-1, EDGE_POINTS * EDGE_SAMPLES, 2)
        value = cv2.remap(image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        rise = np.diff(value.reshape(place.shape[:-1]).astype(float), axis=3).clip(0.0) ** 2 + 1e-9
        between = (offset[..., 1:] + offset[..., :-1])[:, :, None] / 2
        edge = point + ((rise * between).sum(axis=3) / rise.sum(axis=3))[..., None] * out[:, :, None]
        corner = _cross(edge)
    return corner


def _cross(edge: np.ndarray) -> np.ndarray:
    """Return corners (n, 4, 2) where the lines fitted to points on neighbouring sides (n, 4, points, 2) meet."""
    middle = edge.mean(axis=2)
    away = edge - middle[:, :, None]
    _, axes = np.linalg.eigh(np.einsum("nspi,nspj->nsij", away, away))
    normal = axes[..., 0]
    level = (normal * middle).sum(axis=2)
    rows = np.stack([np.roll(normal, 1, axis=1), normal], axis=2)  # a corner is on its own side and the one before
    return np.linalg.solve(rows, np.stack([np.roll(level, 1, axis=1), level], axis=2)[..., None])[..., 0]


def make_detector() -> cv2.aruco.ArucoDetector:
    """Return a detector that accepts no code with a wrong bit.

    It considers only strong contrast, such as that of tags: this is five times faster in a textured room, and as many
    tags are found.
    """
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.errorCorrectionRate = 0.0
    settings.minMarkerPerimeterRate = 0.05
    settings.adaptiveThreshConstant = 20
    settings.adaptiveThreshWinSizeMin, settings.adaptiveThreshWinSizeMax = 5, 21
    settings.adaptiveThreshWinSizeStep = 16
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(_FAMILY), settings)
