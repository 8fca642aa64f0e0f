"""Segments as bars: few unknowns each, from which the positions and headings of all readings follow.

A bar has four unknowns: its beginning (x, y), its heading there and the logarithm of its length's scale. All share
three more: the curvature of what the robot drives for straight, and the camera's place ahead and to the left of the
axle. Where gaps between readings are noisy, a segment is several bars that continue one another.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepgps.data.segments import MIN_DISTANCE_M, Segments
from deepgps.data.turns import CompassTurns

SHARED_UNKNOWNS = 3  # Unknowns of all bars: curvature [1 / m], the camera's place ahead and to the left of the axle [m]
MAX_BEND_M = 0.01  # A segment is cut where its readings may be further from even scaling than this [m]
CONTINUATION_STD_M, CONTINUATION_STD_RAD = 1e-4, 1e-4
"""Standard deviations of where, and in which direction, a bar continues another of the same segment."""
MIN_LENGTH_STD, MAX_LENGTH_STD = 1e-3, 0.7
"""Smallest and largest standard deviation of the logarithm of a bar's length. Where the wheels disagree, it is the
largest: a wheel that sticks halves the length."""
AXLE_UNKNOWNS, CAMERA_UNKNOWNS = slice(0, 4), slice(0, 6)
"""Unknowns, in the order of ``derive``, on which the places of the axle and of the camera depend."""


class Located(NamedTuple):
    """Readings on the map."""

    distance: np.ndarray  # Distance of each from the beginning of its bar (n,) [m]
    heading: np.ndarray  # Heading of the robot (n,) [rad]
    axle: np.ndarray  # Position of the axle's centre (n, 2) [m]
    camera: np.ndarray  # Position of the camera (n, 2) [m]


@dataclass
class Bars:
    """Bars with their readings, and their unknowns."""

    row: np.ndarray  # Bar of each reading (r,)
    observation: np.ndarray  # Observation of each reading (r,)
    along: np.ndarray  # Distance of each reading from the beginning of its bar, by encoder (r,) [m]
    first: np.ndarray  # First reading of each bar (B,)
    last: np.ndarray  # Last reading of each bar (B,)
    segment: np.ndarray  # Segment of each bar (B,)
    scale_std: np.ndarray  # Standard deviation of the logarithm of each bar's scale (B,)
    uneven_m2: np.ndarray  # Expected squared error of each reading's distance once its bar's scale is right (r,) [m^2]
    unknown: np.ndarray  # x, y [m], heading [rad] and logarithm of the scale of each bar (B, 4)
    shared: np.ndarray  # Curvature [1 / m], camera ahead and to the left of the axle [m] (3,)

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return self.unknown.size + SHARED_UNKNOWNS

    @property
    def heading(self) -> np.ndarray:
        """Heading of the robot at each reading (r,) [rad]."""
        return self.locate(slice(None)).heading

    @property
    def camera(self) -> np.ndarray:
        """Position of the camera at each reading (r, 2) [m]."""
        return self.locate(slice(None)).camera

    def locate(self, reading: np.ndarray | slice) -> Located:
        """Where readings (n,) are on the map."""
        x_y, begin, scale = np.split(self.unknown[self.row[reading]], [2, 3], axis=1)
        distance = self.along[reading] * np.exp(scale[:, 0])
        heading = begin[:, 0] + self.shared[0] * distance
        axle = x_y + turn(begin[:, 0], follow_arc(distance, self.shared[0]))
        return Located(distance, heading, axle, axle + turn(heading, np.broadcast_to(self.shared[1:], axle.shape)))

    def find_readings(self, observations: int) -> np.ndarray:
        """The first reading of each of so many observations (observations,); -1: it has none."""
        reading = np.full(observations, -1)
        reading[self.observation[::-1]] = np.arange(len(self.row))[::-1]
        return reading

    def move(self, step: np.ndarray) -> None:
        """Add a step (count,) to the unknowns."""
        self.unknown = self.unknown + step[:-SHARED_UNKNOWNS].reshape(-1, 4)
        self.shared = self.shared + step[-SHARED_UNKNOWNS:]

    def draw_unevenness(self, samples: int, rng: np.random.Generator) -> np.ndarray:
        """Samples (r, 2, samples) [m] of what readings err along their bars once the scales of these are right."""
        ahead = turn(self.heading, np.array([[1.0, 0.0]]))
        drawn = np.sqrt(self.uneven_m2)[:, None] * rng.standard_normal((len(self.row), samples))
        return ahead[:, :, None] * drawn[:, None]

    def derive(self, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and values (n, 2, 6) of the derivatives of cameras' positions, to first order in the curvature."""
        bar, (distance, heading, _, camera) = self.row[reading], self.locate(reading)
        arm = camera - self.unknown[bar, :2]
        one = np.ones(len(reading))
        cos, sin = np.cos(heading), np.sin(heading)
        along = distance[:, None] * np.stack([cos, sin], axis=1)
        bent = turn(self.unknown[bar, 2], np.stack([-self.shared[0] * distance**3 / 3.0, distance**2 / 2.0], axis=1))
        values = np.stack(
            [
                np.stack([one, -arm[:, 1], along[:, 0], bent[:, 0], cos, -sin], axis=1),
                np.stack([one, arm[:, 0], along[:, 1], bent[:, 1], sin, cos], axis=1),
            ],
            axis=1,
        )
        of_all = np.broadcast_to(self.unknown.size + np.arange(SHARED_UNKNOWNS), (len(reading), SHARED_UNKNOWNS))
        columns = np.stack(
            [np.column_stack([4 * bar + axis, 4 * bar + 2, 4 * bar + 3, of_all]) for axis in range(2)], 1
        )
        return columns, values

    def derive_heading(self, reading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and values (n, 2) of the derivatives of headings."""
        columns = np.column_stack([4 * self.row[reading] + 2, np.full(len(reading), self.unknown.size)])
        return columns, np.column_stack([np.ones(len(reading)), self.locate(reading).distance])


def lay_out(segments: Segments, turns: CompassTurns, curvature: float) -> Bars:
    """Lay the bars of all segments, whose errors must be expected, end to end along the compass headings.

    ``curvature`` [1 / m] is that of what the robot drives for straight, to the left.
    """
    index, distance = segments.index.numpy(), segments.distance.double().numpy()
    assert segments.variance is not None, "expect_errors comes first"
    variance = segments.variance.double().numpy()
    parts = [_cut(variance[row, :count]) for row, count in enumerate(segments.count.tolist())]
    segment = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    span = np.concatenate(parts)
    size = span[:, 1] - span[:, 0] + 1
    last = np.cumsum(size) - 1
    row = np.repeat(np.arange(len(span)), size)
    column = np.arange(len(row)) - (last - size + 1)[row] + span[row, 0]
    begin, end = (segment, span[:, 0]), (segment, span[:, 1])
    length = distance[end] - distance[begin]
    squared = variance[end] - variance[begin] + segments.rounding_m2
    scale_std = (np.sqrt(squared) / length.clip(MIN_DISTANCE_M)).clip(MIN_LENGTH_STD, MAX_LENGTH_STD)
    if segments.doubted is not None:
        scale_std[segments.doubted.numpy()[segment]] = MAX_LENGTH_STD
    along = distance[segment[row], column] - distance[begin][row]
    grown = variance[segment[row], column] - variance[begin][row]
    bars = Bars(
        row,
        index[segment[row], column],
        along,
        last - size + 1,
        last,
        segment,
        scale_std,
        _expect_unevenness(along / length.clip(MIN_DISTANCE_M)[row], grown, segments.rounding_m2, last[row]),
        np.zeros((len(span), 4)),
        np.array([curvature, 0.0, 0.0]),
    )
    angle, jump = expand(bars, turns.angle, 0.0), expand(bars, turns.jump, 0.0)
    turned = np.append(0.0, np.cumsum(angle + curvature * length[:-1]))
    bars.unknown[:, 2] = turned
    ahead = turn(turned, follow_arc(length, curvature))
    meet = ahead[:-1] + turn(turned[:-1] + curvature * length[:-1], jump)
    bars.unknown[1:, :2] = np.cumsum(meet, axis=0)
    return bars


def expand(bars: Bars, values: np.ndarray, within: float) -> np.ndarray:
    """Values (B - 1, ...) between consecutive bars, from those between segments (L - 1, ...), and ``within`` these."""
    new = np.diff(bars.segment) > 0
    found = np.full((len(new), *values.shape[1:]), within)
    found[new] = values
    return found


def _cut(variance: np.ndarray) -> np.ndarray:
    gaps = len(variance) - 1
    # Between ends that are known, errors that add up are largest in the middle: half of the root of their sum.
    bars = max(min(int(np.ceil(variance[-1] / (2.0 * MAX_BEND_M) ** 2)), gaps), 1)
    edges = np.rint(np.linspace(0, gaps, bars + 1)).astype(int)
    return np.stack([edges[:-1], edges[1:]], axis=1)


def _expect_unevenness(part: np.ndarray, grown: np.ndarray, rounding_m2: float, last: np.ndarray) -> np.ndarray:
    """Expected squared errors (r,) [m^2] of readings at these parts of the lengths of their bars, both ends known.

    Errors that have ``grown`` from the bar's beginning (r,) [m^2], as a random walk, leave a Brownian bridge, ``v (1 -
    v / v_end)``. The rounding of a reading, half of that of a distance [m^2], adds to that of the ends as it is
    interpolated. ``last`` (r,) is the last reading of each one's bar.
    """
    bridge = grown * (1.0 - grown / grown[last].clip(np.finfo(float).tiny))
    rounding = rounding_m2 / 2.0 * (1.0 + (1.0 - part) ** 2 + part**2)
    changes = np.diff(last, prepend=-1, append=-1) != 0  # of the bar, before each reading and after the last
    return bridge + np.where(changes[:-1] | changes[1:], 0.0, rounding)


def follow_arc(distance: np.ndarray, curvature: float) -> np.ndarray:
    """Places (n, 2) [m] after distances (n,) [m] along an arc that leaves the first axis for the second."""
    half = curvature * distance / 2.0
    chord = distance * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=1)


def turn(angle: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) turned by angles (n,) to the left."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * vector[:, 0] - sin * vector[:, 1], sin * vector[:, 0] + cos * vector[:, 1]], axis=1)
