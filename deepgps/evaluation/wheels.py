"""What a real robot's wheels do: radii, track width and noise by true poses, and settings that do the same here."""

from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar, nnls
from scipy.stats import norm
from scipy.stats import t as student

from deepgps.diagnosis.diagnosis import Estimate
from sim.errors import InputError, one_line, quote, read_file
from sim.rng import stream
from sim.settings import DriveSettings, EncoderSettings

POSE = ("time_s", "x_m", "y_m", "yaw_rad")
COUNTS, INCREMENTS = ("left_ticks", "right_ticks"), ("left_increment", "right_increment")
"""Ticks counted so far, or since the row before."""
ORDER = (*POSE, *reversed(INCREMENTS))  # Columns of a file without a header
LAGS_S = np.arange(-0.5, 0.525, 0.05)  # Delays of the ticks against the poses that are tried first [s]
LAG_WINDOW_S = 0.5  # Time over which ticks and poses are compared [s]
SPACING_M = float(DriveSettings().spacing_m)
LENGTHS_M = (*(SPACING_M * factor for factor in (0.5, 1.0, 2.0, 4.0, 8.0)),)
"""Lengths of the gaps whose errors are compared [m]; shorter ones are the tracker's alone."""
WINDOW_M = LENGTHS_M[3]  # Length of the gaps that calibrate the wheels [m]
CURVE_PER_M = 1.0  # Curvature from which a gap is a curve [1/m]
GATE = 10.0  # Robust standard deviations beyond which a gap does not calibrate: the tracker jumped
MINIMA = {"runs": 3, "m": 10.0, "rad of turns": 2 * np.pi}  # What is needed at least
MIN_GAPS, MIN_END_M = 30, 2.0  # Fewest gaps of which a spread is used; shortest run whose end is compared [m]
MAX_ERROR = 0.2  # Largest error of the constants assumed, as a part, that is taken for one
RESAMPLES = 100


class WheelRun(NamedTuple):
    """One run, at the times of its rows."""

    angle: np.ndarray  # Angles of the left and the right wheel since the first row (N, 2) [rad]
    place: np.ndarray  # True positions x + iy (N,) [m]
    yaw: np.ndarray  # True headings without jumps (N,) [rad]


def read_run(path: Path, ticks_per_rev: float, assumed: Sequence[float]) -> WheelRun:
    """Read a run, and take off the delay between its ticks and poses, as found with the constants assumed.

    These are the left and the right radius and the track width [m]. Raises InputError if the file is no such table.
    """
    data = read_file(path, 2**30, str(path)).decode("utf-8-sig", "replace")
    names = [cell.strip() for cell in data.partition("\n")[0].split(",")]
    header = any(cell[:1].isalpha() for cell in names)
    names = names if header else list(ORDER)
    counted = COUNTS if COUNTS[0] in names else INCREMENTS
    if missing := [name for name in (*POSE, *counted) if name not in names]:
        raise InputError(f"{path}: there is no column {missing[0]}; its first line is {quote(','.join(names))}")
    if data.count("\n") < 3 or (not header and data.partition("\n")[0].count(",") != len(ORDER) - 1):
        raise InputError(f"{path}: must be a table with a header or {len(ORDER)} columns, and three rows or more")
    used = [names.index(name) for name in (*POSE, *counted)]
    try:
        values = np.loadtxt(StringIO(data), delimiter=",", skiprows=int(header), usecols=used, ndmin=2)
    except ValueError as error:
        raise InputError(f"{path}: must be numbers of {', '.join(names)}: {one_line(error)}") from None
    time, x, y, yaw, *ticks = values.T
    for wrong, why in (
        (~np.isfinite(values).all(axis=1), "a value is no number; leave such rows out, and let ticks count on"),
        (np.diff(time, prepend=-np.inf) <= 0.0, "time_s must rise from row to row"),
        ((values[:, 4:] % 1.0 != 0.0).any(axis=1), f"{' and '.join(counted)} must be whole numbers"),
    ):
        if wrong.any():
            raise InputError(f"{path}: line {wrong.argmax() + 1 + header}: {why}")
    turned = np.cumsum(ticks, axis=1) if counted is INCREMENTS else np.array(ticks)
    run = WheelRun((turned - turned[:, :1]).T * (2 * np.pi / ticks_per_rev), x + 1j * y, np.unwrap(yaw))
    return _take_off_lag(time, run, assumed)


def _take_off_lag(time: np.ndarray, run: WheelRun, assumed: Sequence[float]) -> WheelRun:
    heading, place, _ = reckon(run, assumed)
    apart = max(round(LAG_WINDOW_S * len(time) / max(time[-1] - time[0], LAG_WINDOW_S)) - 1, 1)

    def shift(lag_s: float) -> WheelRun:
        x, y, yaw = (np.interp(time + lag_s, time, one) for one in (run.place.real, run.place.imag, run.yaw))
        return run._replace(place=x + 1j * y, yaw=yaw)

    def cost(lag_s: float) -> float:
        moved = shift(lag_s)
        true, ours, turn = (one[apart:] - one[:-apart] for one in (moved.place, place, moved.yaw - heading))
        return float((np.abs(np.abs(true) - np.abs(ours)) + np.abs(turn) * assumed[2] / 2.0).mean())

    best = min(LAGS_S, key=cost)
    return shift(minimize_scalar(cost, bounds=(best - 0.05, best + 0.05), method="bounded").x)


def reckon(run: WheelRun, drive: Sequence[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Headings (N,) [rad], positions x + iy (N,) and distances driven, the mean of both wheels, (N,) [m], from 0."""
    step = np.diff(run.angle, axis=0, prepend=run.angle[:1]) * np.array(drive[:2])
    turn = (step[:, 1] - step[:, 0]) / drive[2]
    heading = np.cumsum(turn)
    chord = step.mean(axis=1) * np.sinc(turn / (2 * np.pi)) * np.exp(1j * (heading - turn / 2.0))
    return heading, np.cumsum(chord), np.cumsum(np.abs(step).mean(axis=1))


class Model(NamedTuple):
    """Wheels and tracker; errors of gaps grow with the root of what they are divided by."""

    left_m: float  # Radius of the left wheel [m]
    right_m: float  # Radius of the right wheel [m]
    track_m: float  # Distance between the wheels [m]
    step_noise: float  # Noise w of a gap of the simulator, beside slip
    slip_per_m: float  # Slip of a wheel after a metre [m]
    length_per_m: float  # Error of the length by the wheels after a metre, by both of these [m]
    heading_per_m: float  # Error of the heading after a metre, by slip [rad]
    heading_per_rad: float  # Error of the heading after a turn of a radian, beside that [rad]
    tracker_m: float  # Error of a gap's length by the tracker [m]
    tracker_rad: float  # Error of a gap's turn by the tracker [rad]

    def expect_spread(self, length_m: float) -> float:
        """Standard deviation of the error of a gap of this length, the tracker's included [m]."""
        return float(np.hypot(self.tracker_m, self.length_per_m * length_m**0.5))

    def make_settings(self, assumed: Sequence[float], ticks_per_rev: float) -> EncoderSettings:
        """The simulator's settings for such wheels, of which other radii and another track width are assumed [m]."""
        left, right, track = (one / true - 1.0 for one, true in zip(assumed[:3], self, strict=False))
        noise = {"slip_per_m": self.slip_per_m, "step_noise": self.step_noise, "ticks_per_rev": round(ticks_per_rev)}
        return EncoderSettings(radius_error_left=left, radius_error_right=right, track_error=track, **noise)


class Wheels(NamedTuple):
    """What was measured of a robot's wheels."""

    model: Model
    intervals: dict[str, Estimate]  # Each part of the model with its 95 % interval
    gaps: dict[float, np.recarray]  # Gaps by their length [m]
    # Median distance of the ends of runs to the true ones, as assumed, and by the other runs [m]
    ends_m: dict[str, tuple[float, float]]


def measure_wheels(runs: Sequence[WheelRun], groups: Sequence[str], assumed: Sequence[float]) -> Wheels:
    """Calibrate the wheels of runs, and measure their noise; runs of one group are left out and drawn together.

    The left and the right radius and the track width are assumed [m]. Raises InputError if runs are too few or differ.
    """
    gap, drive, rows, rng = cut(runs, assumed, WINDOW_M), tuple(assumed), np.arange(len(runs)), stream(0, "wheels")
    for value, what in zip((len(runs), gap.length.sum(), np.abs(gap.heading).sum()), MINIMA, strict=True):
        if value < MINIMA[what]:
            raise InputError(f"too few {what}: {value:.3g}, and wheels are calibrated by {MINIMA[what]:.3g} or more")
    for _ in range(3):  # the path that is compared depends on the constants
        drive = fit_drive(cut(runs, drive, WINDOW_M), drive)
    if not (np.abs(np.divide(drive, assumed) - 1.0) < MAX_ERROR).all():
        raise InputError(
            "left and right radius and track width would be {:.4g}, {:.4g} and {:.4g} m: are positions in m, "
            "yaw in rad, sides right, ticks counted so far or since the row before as the columns say?".format(*drive)
        )
    gaps: dict[float, Any] = {length: cut(runs, drive, length) for length in LENGTHS_M}
    of_run = {key: [np.flatnonzero(gap.run == row) for row in rows] for key, gap in gaps.items()}

    def estimate(chosen: np.ndarray) -> Model:
        picked = {key: gap[np.concatenate([of_run[key][row] for row in chosen])] for key, gap in gaps.items()}
        return fit_noise(picked, fit_drive(picked[WINDOW_M], drive))

    model, intervals, ends, names = estimate(rows), {}, {}, dict.fromkeys(groups)
    if np.isnan(model).any():
        raise InputError(f"too few gaps tell their noise: {MIN_GAPS} straight ones of three lengths are needed")
    parts = [rows[np.array([one == name for one in groups])] for name in names] if len(names) > 1 else rows[:, None]
    draws = ([parts[one] for one in rng.integers(len(parts), size=len(parts))] for _ in range(RESAMPLES))
    std = np.nanstd(np.array([estimate(np.concatenate(draw)) for draw in draws]), axis=0, ddof=1)
    factor = student.ppf(0.975, len(parts) - 1)
    for name, value, off in zip(Model._fields, model, std, strict=True):
        intervals[name] = Estimate(value, max(value - factor * off, 0.0), value + factor * off, off)
    for name, part in zip(names, parts, strict=True) if len(names) > 1 else ():
        if long := [runs[row] for row in part if reckon(runs[row], assumed)[2][-1] >= MIN_END_M]:
            both = (assumed, estimate(np.setdiff1d(rows, part))[:3])
            ends[name] = tuple(np.median([[measure_end(run, one) for one in both] for run in long], axis=0).tolist())
    return Wheels(model, intervals, gaps, ends)


def cut(runs: Sequence[WheelRun], drive: Sequence[float], length_m: float) -> np.recarray:
    """Gaps of about a length of the wheels' distance [m], one after the other: ``run``, the angles of both wheels,
    ``yaw`` by the tracker and ``heading`` by the wheels [rad], ``length`` [m] and, in the frame of the path by the
    wheels, the chords ``true`` and ``reckoned`` [m] and how a point a metre ahead moves beside the axle, ``lever``."""
    parts = []
    for number, run in enumerate(runs):
        heading, place, driven = reckon(run, drive)
        marks = np.arange(0.0, driven[-1] + length_m / 2.0, length_m).clip(max=driven[-1])
        marks = np.unique(np.searchsorted(driven, marks))
        first, last = marks[:-1], marks[1:]
        total = np.concatenate([[0.0], np.cumsum(run.yaw - heading)])
        frame = np.exp(-1j * (total[last + 1] - total[first]) / (last + 1 - first))  # a mean, as the tracker is noisy
        along = (*run.angle.T, run.yaw, heading, driven, place, np.exp(1j * heading), run.place)
        *columns, true = (one[last] - one[first] for one in along)
        names: Any = "run,left,right,yaw,heading,length,reckoned,lever,true"
        parts.append(np.rec.fromarrays([np.full(len(first), number), *columns, true * frame], names=names))
    return np.concatenate(parts).view(np.recarray)


def fit_drive(gaps: np.recarray, drive: Sequence[float]) -> tuple[float, ...]:
    """Radii and track width [m] that fit gaps best, by two linear problems, of turns and of chords by ``drive``.

    The tracker explains the wheels, as it errs less. The tracked point may be beside the axle's middle.
    """
    turns = np.column_stack([gaps.yaw, (gaps.left + gaps.right) / 2.0])
    pairs = ((turns, gaps.right - gaps.left), (np.column_stack([gaps.true, gaps.lever]), gaps.reckoned))
    kept = np.ones(len(gaps), bool)
    for _ in range(4):
        turn, chord = found = [np.linalg.lstsq(known[kept], sought[kept], rcond=None)[0] for known, sought in pairs]
        off = np.abs([sought - known @ one for (known, sought), one in zip(pairs, found, strict=True)])
        kept = (off <= GATE * 1.4826 * np.median(off[:, kept], axis=1, keepdims=True) + 1e-9).all(axis=0)
    radius_m = (drive[0] + drive[1]) / 2.0 / float(abs(chord[0]))  # chords do not know the track width
    return radius_m * (1.0 + turn[1] / 2.0), radius_m * (1.0 - turn[1] / 2.0), radius_m * turn[0]


def list_errors(gaps: np.recarray) -> dict[str, tuple[np.ndarray, ...]]:
    """Errors of gaps with their chords [m] and turns [rad]: of lengths, ``along`` [m], and of turns, where the robot
    drives ``straight`` or a ``curve`` [rad]."""
    chord, turned = np.abs(gaps.reckoned), np.abs(gaps.heading)
    along = ((gaps.reckoned - gaps.true) * np.exp(-1j * np.angle(gaps.reckoned))).real
    drift, curve = gaps.heading - gaps.yaw, turned >= CURVE_PER_M * gaps.length
    parts = {"along": (along, chord > 0.9 * gaps.length), "straight": (drift, ~curve), "curve": (drift, curve)}
    return {name: tuple(one[part] for one in (error, chord, turned)) for name, (error, part) in parts.items()}


def measure_spread(error: np.ndarray) -> float:
    """Standard deviation of a normal distribution with the same quantiles of 5 and 95 %."""
    return float(np.ptp(np.quantile(error, [0.05, 0.95])) / np.ptp(norm.ppf([0.05, 0.95])))


def fit_noise(gaps: dict[float, np.recarray], drive: Sequence[float]) -> Model:
    """The model of these radii and this track width [m] by how squared spreads grow with lengths and turns.

    In curves the tracker's noise is another one, and the drift is what the chord does not explain.
    """
    points: dict[str, list[tuple[float, ...]]] = {"along": [], "straight": [], "curve": []}
    for one in gaps.values():
        for name, (error, chord, turned) in list_errors(one).items():
            if len(error) >= MIN_GAPS:
                points[name].append((measure_spread(error) ** 2, len(error), chord.mean(), turned.mean()))
    (tracker_m2, along), (tracker_rad2, per_m) = (_fit_growth(points[name]) for name in ("along", "straight"))
    curves = [(square - per_m * chord, count, turned) for square, count, chord, turned in points["curve"]]
    per_rad = np.nan_to_num(_fit_growth(curves)[1])
    slip2 = drive[2] ** 2 * per_m / 2.0
    squares = [max(along - slip2 / 2.0, 0.0) / SPACING_M, slip2, along, per_m, per_rad, tracker_m2, tracker_rad2]
    return Model(*map(float, drive), *np.sqrt(squares).tolist())


def _fit_growth(points: Sequence[tuple[float, ...]]) -> tuple[float, float]:
    """Beginning and slope, none negative, of squares, each with its number of gaps and its place; nan of too few."""
    if len(points) < 3:
        return np.nan, np.nan
    square, count, place = np.array(points).T[:3]
    weight = np.sqrt(count) / np.maximum(square, square.max() / 100.0 + 1e-18)
    begin, slope = nnls(np.column_stack([weight, place * weight]), square * weight)[0]
    return float(begin), float(slope)


def measure_end(run: WheelRun, drive: Sequence[float]) -> float:
    """Distance between the ends of a run by its wheels and by the tracker [m], from the same beginning."""
    heading, place, driven = reckon(run, drive)
    first = int(np.searchsorted(driven, SPACING_M)) + 1  # the first heading is a mean, too
    turned = np.exp(1j * float((run.yaw - heading)[:first].mean()))
    return float(abs(run.place[-1] - run.place[0] - place[-1] * turned))
