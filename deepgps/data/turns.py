"""How far the robot turned, by images: between segments, between any two near images, and as the camera leans.

By the compass, the two images of a turn show how far the heading changes. The wheels choose between the peaks of the
compass and count whole turns; they never change an angle. The lean is measured over all turns of the training drive,
and again over the last turns of a deployment drive. Smaller leans than ``MIN_LEAN_RAD`` are not corrected, so that the
images of a level camera stay as they are.

Of images taken centimetres apart a coarse description is as good as the whole images: a few rings without colours, and
slow waves around the circle. Error RMS: 0.2 to 0.4 degrees within 2 cm, 13 degrees for each metre beyond. The ground
truth is not used.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import fft

from deepgps.data.segments import Segments, dead_reckon, find_runs, travel
from sim.errors import InputError
from sim.geometry import wrap
from sim.recording.format import Recording
from sim.recording.turns import KINDS, NO_IMAGE, Turns, from_array
from sim.sensors.camera.lens import make_lens
from sim.sensors.camera.mount import Upright
from sim.sensors.visual_compass import Hypotheses, compare_at_horizon, disambiguate, find_highest, find_lean, find_turns
from sim.settings import SimSettings


def turns_with_images(recording: Recording) -> Turns | None:
    """The turns of a recording; None unless it has polar images before and after them."""
    return recording.turns if recording.turn_observation is not None and recording.kind == "polar_image" else None


def take_images(recording: Recording, turns: Turns) -> tuple[np.ndarray, np.ndarray]:
    """Images before and after some of a recording's turns, both (T, rings, sectors, channels)."""
    assert recording.turn_observation is not None
    after, taken = recording.observation[find_next(recording, turns)], turns.image != NO_IMAGE
    after[taken] = recording.turn_observation[turns.image[taken]]
    return recording.observation[turns.before], after


def find_next(recording: Recording, turns: Turns) -> np.ndarray:
    """First observation (T,) of the segment after each turn: where the robot backed off, its reading may be lost."""
    first = recording.reading[turns.after, 1]
    return np.where(turns.kind == KINDS.index("backed_off"), np.minimum(turns.before + 1, first), first)


def find_in_place(turns: Turns) -> np.ndarray:
    """Indices of the turns in place with an image after them."""
    return np.flatnonzero((turns.kind == KINDS.index("in_place")) & (turns.image != NO_IMAGE))


MIN_LEAN_RAD = np.radians(0.1)  # Leans, or differences of leans, up to this are not corrected [rad]
LAST_TURNS = 5  # Turns in place from which the lean in deployment is measured
MAX_TURNS = 100  # Turns in place from which the lean of the training drive is measured, spread evenly over it
MAX_ROUNDS = 5
"""Most corrections of the lean: of two images that lean by many degrees apart, one fit finds only a part of it."""


class SeenTurns(NamedTuple):
    """What the images before and after some turns tell."""

    hypotheses: Hypotheses  # Of the angles turned by the robot, corrected for the camera's lean
    upright: Upright  # What sets its images upright, however small its lean is


def compare_images(recording: Recording, turns: Turns | None = None, trained: Upright | None = None) -> SeenTurns:
    """Compare the images before and after each turn of a recording, or some of its turns.

    Images of a camera that leans are set upright and compared again, until the lean that is left is small. Once
    ``trained``, it begins with that lean and the parallax, which lasts: the lean is then that of all rings less the
    parallax, which takes fewer turns; else it is measured near the horizon, without parallax. Raises InputError if the
    recording has no turns or no polar images.
    """
    if (recorded := turns_with_images(recording)) is None:
        raise InputError(
            f"{recording.folder} has no images after turns (turns.npy), which a compass needs; deepgps learns without"
        )
    turns = recorded if turns is None else turns
    before, after = take_images(recording, turns)
    some = find_in_place(turns)
    some = some[:: -(-len(some) // MAX_TURNS) or 1]
    lens = make_lens(SimSettings.model_validate(recording.manifest.settings).camera)
    upright = trained or Upright(lens, (0.0, 0.0))
    for _ in range(MAX_ROUNDS):
        one, two = upright(before), upright(after)
        seen, hidden = find_turns(one, two, lens), float(np.linalg.norm(upright.lean))
        apparent = _find_lean(Hypotheses(*(array[some] for array in vars(seen).values())))
        step, parallax = apparent - upright.parallax, np.array(upright.parallax)
        if trained is None:
            step = _find_lean(compare_at_horizon(one[some], two[some], seen.angle[some, 0], lens, hidden))
            parallax = apparent - step
        upright = Upright(lens, _pair(upright.lean + step), _pair(parallax))
        if np.linalg.norm(step) <= MIN_LEAN_RAD:
            break
    else:  # the lean has changed since
        seen = find_turns(upright(before), upright(after), lens)
    return SeenTurns(seen, replace(upright, wobble=find_wobble(seen.lean[some, 0])))


def find_wobble(relative: np.ndarray) -> float:
    """Standard deviation of a lean along each axis [rad] by relative leans of pairs (n, 2): twice its variance.

    A few pairs are wrong, hence the median.
    """
    squared = np.square(relative[np.isfinite(relative[:, 0])]).sum(axis=1)
    return float(np.sqrt(np.median(squared) / (4.0 * np.log(2.0)))) if len(squared) else 0.0


def _find_lean(hypotheses: Hypotheses) -> np.ndarray:
    return np.nan_to_num(find_lean(hypotheses))


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def ignore_small(upright: Upright) -> Upright:
    """The same, but images of a camera that leans by ``MIN_LEAN_RAD`` or less stay as they are."""
    return replace(upright, lean=(0.0, 0.0)) if np.linalg.norm(upright.lean) <= MIN_LEAN_RAD else upright


def adapt_upright(trained: Upright, drive: Recording) -> tuple[Upright, Upright | None]:
    """What sets the images of a deployment drive upright, whose camera may have been knocked since training.

    That of training, unless the lean has changed by more than ``MIN_LEAN_RAD``; and what is measured in deployment,
    None where the drive has fewer than ``LAST_TURNS`` turns in place.
    """
    turns = turns_with_images(drive)
    if turns is None or len(last := find_in_place(turns)[-LAST_TURNS:]) < LAST_TURNS:
        return trained, None
    found = compare_images(drive, from_array(turns.array[last]), trained).upright
    changed = np.linalg.norm(np.subtract(found.lean, trained.lean)) > MIN_LEAN_RAD
    return (found if changed else trained), found


def describe_lean(measured: Upright) -> dict[str, float]:
    """Entries for ``training.json`` and ``metrics.json`` of how a camera leans."""
    roll, pitch, wobble = np.degrees((*measured.lean, measured.wobble)).round(4).tolist()
    return {"lean_roll_deg": roll, "lean_pitch_deg": pitch, "wobble_deg": wobble}


WHEEL_TURN_STD_RAD, PUSHED_TURN_STD_RAD = 0.3, 1.5
"""Standard deviations of a turn by the wheels, to choose between peaks: they may slip, and what the robot touched may
have turned it by a right angle while they did not move [rad]."""
WANDER_STD_RAD = np.radians(0.07)
"""Standard deviation of a segment's mean heading against its heading at the ends [rad]."""
BACK_OFF_STD_M, MEETING_STD_M = 0.05, 0.001
"""Standard deviations of where a segment begins after the robot backed off, and where it turned in place [m]."""
SPACING_STD_SHARE = 0.3  # Standard deviation of the distance between images, as a part of it, where readings were lost
UNKNOWN_STD_RAD, UNKNOWN_STD_M = 3.0, 10.0
"""Standard deviations of a turn and of a distance of which nothing is known: the robot was carried [rad], [m]."""


@dataclass(frozen=True)
class CompassTurns:
    """The turns between consecutive rows of ``Segments``."""

    angle: np.ndarray  # Turn to the left (L - 1,) [rad]
    angle_std: np.ndarray  # Its standard deviation (L - 1,) [rad]
    jump: np.ndarray  # From the end of a segment to the beginning of the next, in the frame of the first (L - 1, 2) [m]
    jump_std: np.ndarray  # Its standard deviation along each axis (L - 1,) [m]
    upright: Upright | None = None  # What sets images of the camera upright; the angles are corrected for its lean


def measure_turns(recording: Recording) -> CompassTurns:
    """Measure all turns of a recording, and the camera's lean, which changes what an image shows of a turn.

    Raises InputError if the recording has no turns or no polar images.
    """
    (seen, upright), turns = compare_images(recording), recording.turns
    assert turns is not None
    yaw = dead_reckon(recording)[:, 2]
    wheels = yaw[turns.after] - yaw[turns.after - 1]
    spread = trust_wheels(turns)
    found = disambiguate(seen, wheels, spread)
    known = np.isfinite(found.angle[:, 0]) & (turns.kind != KINDS.index("relocated"))
    angle = np.where(known, found.angle[:, 0], wheels)
    likely = np.where(found.weight > 0.0, found.weight, 0.0)
    apart = np.nansum(likely * (found.angle - found.angle[:, :1]) ** 2, axis=1)  # where several peaks are likely
    variance = np.where(known, found.std[:, 0] ** 2 + WANDER_STD_RAD**2 + apart, spread**2)
    return replace(_join(recording, angle, variance), upright=upright)


def trust_wheels(turns: Turns) -> np.ndarray:
    """Standard deviation of each turn (T,) by the wheels, to choose between peaks of the compass [rad]."""
    return np.where(turns.kind == KINDS.index("in_place"), WHEEL_TURN_STD_RAD, PUSHED_TURN_STD_RAD)


def _join(recording: Recording, angle: np.ndarray, variance: np.ndarray) -> CompassTurns:
    """Turns (L - 1) between the segments that have at least two readings, from all turns (T,)."""
    assert recording.turns is not None
    turns, runs = recording.turns, find_runs(recording)
    travelled = travel(recording.reading[:, 2:], recording.manifest.odometry).mean(axis=1)
    numbers = {int(row): number for number, row in enumerate(turns.after)}
    rows, turned, squared = [], 0.0, 0.0
    jump, jump_squared = np.zeros(2), MEETING_STD_M**2
    gap = np.diff(recording.reading[:, :2], axis=0)
    beside = (gap[:, 0] == 0) & (gap[:, 1] == 1)
    step_m = float(np.median(np.abs(np.diff(travelled)[beside]))) if beside.any() else 0.0
    begun = False
    for before, run in zip([runs[0], *runs], runs, strict=False):
        number = numbers.get(int(run[0]))
        skipped = recording.reading[run[0], 0] - recording.reading[before[-1], 0] > 1
        if begun and (number is None or skipped):
            squared, jump_squared = squared + UNKNOWN_STD_RAD**2, jump_squared + UNKNOWN_STD_M**2
        if begun and number is not None:
            distance_m = travelled[run[0]] - travelled[before[-1]]
            last, place, first = recording.reading[before[-1], 1], turns.before[number], recording.reading[run[0], 1]
            ahead = _direct(turned)
            if KINDS[turns.kind[number]] == "relocated":
                squared, jump_squared = squared + UNKNOWN_STD_RAD**2, jump_squared + UNKNOWN_STD_M**2
            elif KINDS[turns.kind[number]] == "backed_off":
                on_m = max(first - place - 1, 0) * step_m  # driven after it, before the first reading that arrived
                jump = jump + (distance_m - on_m) * ahead + on_m * _direct(turned + angle[number])
                jump_squared += BACK_OFF_STD_M**2 + (SPACING_STD_SHARE * on_m) ** 2
            elif first > last:  # readings at the turn were lost
                share = (place - last) / (first - last)
                jump = jump + distance_m * (share * ahead + (1.0 - share) * _direct(turned + angle[number]))
                if last < place < first:  # nothing was measured at the turn itself: images are evenly spaced, roughly
                    jump_squared += (SPACING_STD_SHARE * distance_m / (first - last)) ** 2
            turned, squared = turned + angle[number], squared + variance[number]
        if len(run) >= 2:
            if begun:
                rows.append((turned, np.sqrt(squared), *jump, np.sqrt(jump_squared)))
            begun, turned, squared, jump, jump_squared = True, 0.0, 0.0, np.zeros(2), MEETING_STD_M**2
    table = np.array(rows).reshape(-1, 5)
    return CompassTurns(table[:, 0], table[:, 1], table[:, 2:4], table[:, 4])


def _direct(heading: float) -> np.ndarray:
    return np.array([np.cos(heading), np.sin(heading)])


RINGS = 8
WAVES = 24  # Highest number of cycles around the circle
HIGH_PASS_CYCLES = 6.0  # Slow changes of light are suppressed by k / (k + HIGH_PASS_CYCLES), k in cycles per turn
OVERSAMPLING = 8  # Samples of the correlation for each cycle of the highest wave
MAX_PEAK_RATIO = 0.9  # A second peak of the correlation above this part of the first leaves the heading open
MAX_STEPS = 1500  # Steps between readings that measure the curvature at most
MAX_STEP_RAD = 0.5  # No robot turns by more from one reading to the next of a segment [rad]
CHUNK = 1000


@dataclass(frozen=True)
class Headings:
    """Relative headings of n pairs of images."""

    turn: np.ndarray  # Angle from the first image's heading to the second's, to the left (n,) [rad]
    clear: np.ndarray  # Whether the correlation has one highest peak only (n,) bool


def compare_headings(images: np.ndarray, first: np.ndarray, second: np.ndarray) -> Headings:
    """Compare the headings of pairs (n,), (n,) of polar images (N, rings, sectors, channels)."""
    seen, place = np.unique(np.concatenate([first, second]), return_inverse=True)
    waves = _describe_all(images, seen)
    one, other = place[: len(first)], place[len(first) :]
    turn, clear = np.empty(len(first)), np.empty(len(first), bool)
    for start in range(0, len(first), CHUNK):
        part = slice(start, start + CHUNK)
        turn[part], clear[part] = _compare(waves[one[part]], waves[other[part]])
    return Headings(turn, clear)


def measure_curvature(images: np.ndarray, segments: Segments) -> float:
    """Measure the curvature of what the robot drives for straight, to the left [1 / m]; right to about 0.01.

    What the robot passes on its left and right turns single pairs of polar images (N, ...), and the mean hardly. The
    first readings of segments may have been taken before a turn and do not count.
    """
    valid = segments.valid.numpy()[:, 2:]
    index, distance = segments.index.numpy()[:, 1:], segments.distance.numpy()[:, 1:]
    first, second = index[:, :-1][valid], index[:, 1:][valid]
    step = (distance[:, 1:] - distance[:, :-1])[valid]
    chosen = np.linspace(0, len(step) - 1, min(MAX_STEPS, len(step))).astype(int)
    headings = compare_headings(images, first[chosen], second[chosen])
    used = headings.clear & (np.abs(headings.turn) < MAX_STEP_RAD)
    driven = float(step[chosen][used].sum())
    return float(headings.turn[used].sum()) / driven if driven > 0.0 else 0.0


def _describe_all(images: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    parts = [_describe(images[chosen[i : i + CHUNK]]) for i in range(0, len(chosen), CHUNK)]
    return np.concatenate(parts) if parts else np.empty((0, RINGS, WAVES + 1), np.complex64)


def _describe(images: np.ndarray) -> np.ndarray:
    """Waves (n, RINGS, WAVES + 1) around the rings, weighted by their circumference in a fisheye image."""
    rings, sectors = images.shape[1:3]
    channels = images.reshape(-1, images.shape[3]).astype(np.float32)
    grey = (channels @ np.full(images.shape[3], 1.0 / images.shape[3], np.float32)).reshape(images.shape[:3])
    ring = np.arange(rings)
    block = min(RINGS, rings) * ring // rings
    gather = np.where(block == np.unique(block)[:, None], np.sqrt(ring + 0.5), 0.0).astype(np.float32)
    blocks = gather @ grey
    wave = np.arange(min(WAVES, sectors // 2 - 1) + 1)
    return (np.asarray(fft.rfft(blocks))[..., : len(wave)] * (wave / (wave + HIGH_PASS_CYCLES))).astype(np.complex64)


def _compare(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    correlation = np.asarray(fft.irfft((one * other.conj()).sum(axis=1), OVERSAMPLING * 2 * WAVES))
    angle, height = find_highest(correlation, 2)
    return wrap(angle[:, 0]), height[:, 1] < MAX_PEAK_RATIO * height[:, 0]
