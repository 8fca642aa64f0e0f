"""The diagnosis of a recording: each quantity of the wheels with its 95 % interval, by the robot's own sensors.

What cannot be known: a factor that all distances share. The camera measures angles only, and an angle by the wheels is
a ratio of distances, so the track width is known in the metres of the odometry: ``track_m`` makes turns right, whatever
a metre of the readings is in truth.
"""

from dataclasses import dataclass, replace

from threadpoolctl import threadpool_limits

from deepgps.data.checks import check_recording
from deepgps.data.turns import turns_with_images
from deepgps.diagnosis.gaps import Z95, Gaps, fit_slip, fit_step_noise, measure_loss, measure_stuck, read_gaps
from deepgps.diagnosis.turning import MIN_EVIDENCE, measure_curvature, measure_turn_scale, see_turns
from sim.errors import InputError
from sim.recording.format import Recording
from sim.sensors.encoder import check_odometry

LEARNED_QUANTITIES = ("step_noise", "slip_per_m", "track_m")
"""Quantities that methods take in place of what the odometry says."""
SCALE_STD, CURVE_STD, DRIFT_STD = 3.5e-4, 3e-4, 3e-5
"""What wheels do by themselves on a floor, where nothing is wrong: error of the scale of turns, of a curvature [1/m],
and of the ratio of the readings. Measured without faults: the first in ten rooms of six kinds, the others in three."""
MIN_READINGS = 3  # Readings that a diagnosis needs at least
MAX_WHEEL_DIFFERENCE = 1.9  # Largest difference of the wheels' distances over their mean of which a ratio is taken


@dataclass(frozen=True)
class Estimate:
    """A quantity with its 95 % interval; ``std`` is none where the interval is not symmetric."""

    value: float
    low: float
    high: float
    std: float | None = None

    @property
    def known(self) -> bool:
        """Whether anything was measured."""
        return self.high < 1.0 if self.std is None else self.std < 0.1


@dataclass(frozen=True)
class StuckStretch:
    """A stretch in which one wheel counts nothing: its wheel, and when it begins and ends [s]."""

    wheel: str
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class Diagnosis:
    """What was measured of the wheels."""

    track_m: Estimate  # Track width that makes turns by the wheels agree with the camera, in the odometry's metres [m]
    # Distance that the right wheel reads over what the left one reads, for the same angle of both
    reading_ratio: Estimate
    wheel_ratio: Estimate  # Radius of the right wheel over that of the left one; not 1: the robot curves
    step_noise: Estimate  # Noise ``w`` of each gap, as a part of it
    slip_per_m: Estimate  # Standard deviation of a wheel's slip after a metre [m]
    tick_m: Estimate  # Distance that a wheel travels between two counts [m]
    dropout: Estimate  # Part of the readings that never arrived
    stuck_fraction: Estimate  # Part of the gaps in which a wheel is stuck
    stretches: tuple[StuckStretch, ...]  # Stretches in which a wheel is stuck
    turns: int  # Turns in place that were compared
    pairs: int  # Pairs of images from which the curvature was found
    odometry: dict[str, float]  # The constants that the readings were converted with

    @property
    def quantities(self) -> dict[str, Estimate]:
        """All estimates by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, Estimate)}

    @property
    def turn_scale(self) -> Estimate:
        """Turns by the wheels over turns by the camera."""
        track_m, found = self.odometry["track_m"], self.track_m
        std = None if found.std is None else found.std / track_m
        return Estimate(found.value / track_m, found.low / track_m, found.high / track_m, std)


def can_diagnose(recording: Recording) -> bool:
    """Whether a recording has images after turns, enough readings, and readings that are the wheels' own."""
    enough = turns_with_images(recording) is not None and len(recording.reading) >= MIN_READINGS
    return enough and not recording.manifest.wheels_computed


@threadpool_limits.wrap(limits=1)  # with more threads, sums depend on the number of cores
def diagnose(recording: Recording) -> Diagnosis:
    """Diagnose the wheels of a recording; noise in its odometry's data sheet is not used.

    Raises InputError if it has no images after turns, or its readings cannot be used.
    """
    if recording.manifest.wheels_computed:
        raise InputError(f"{recording.folder}: its wheels were computed from an odometry, which cannot be diagnosed")
    check_recording(recording)
    lost = measure_loss(recording) if recording.turn_observation is not None else (0.0, 0.0, 1.0)
    odometry = dict(check_odometry(recording.manifest.odometry))
    if len(recording.reading) < MIN_READINGS:
        raise InputError(f"{recording.folder}: {len(recording.reading)} readings are too few for a diagnosis")
    gaps = read_gaps(recording)
    slip = fit_slip(gaps)
    noise = fit_step_noise(gaps, slip.value)
    seen = see_turns(recording)
    scale, turns = measure_turn_scale(recording, gaps, seen, slip.value, noise.value)
    curve, pairs = measure_curvature(recording, gaps, seen, scale.value)
    track_m = odometry["track_m"]
    scale_std = (scale.std**2 + SCALE_STD**2) ** 0.5
    apart = curve.value * scale.value * track_m
    metres = slip.value / max(2.0 * gaps.distance[gaps.inside].mean(axis=1).sum(), 1e-9) ** 0.5  # error of all distance
    apart_std = (track_m**2 * (curve.std**2 + CURVE_STD**2) + apart**2 * (scale_std**2 + metres**2)) ** 0.5
    return Diagnosis(
        track_m=_symmetric(track_m * scale.value, track_m * scale_std),
        reading_ratio=_ratio(slip.drift, (slip.drift_std**2 + DRIFT_STD**2) ** 0.5),
        wheel_ratio=_ratio(apart, apart_std),
        step_noise=Estimate(noise.value, noise.low, noise.high),
        slip_per_m=Estimate(slip.value, slip.low, slip.high),
        tick_m=Estimate(gaps.tick_m, gaps.tick_m, gaps.tick_m),
        dropout=Estimate(*lost),
        stuck_fraction=Estimate(*measure_stuck(gaps)),
        stretches=_tell_stretches(recording, gaps),
        turns=turns,
        pairs=pairs if pairs >= MIN_EVIDENCE else 0,
        odometry={name: float(odometry[name]) for name in ("wheel_radius_m", "track_m", "ticks_per_rev")},
    )


def apply_diagnosis(recording: Recording, diagnosis: Diagnosis) -> Recording:
    """The recording with noise and track width as diagnosed in its odometry, where they are known.

    A track width that may be the one assumed stays: where turns by the wheels are noisy, it is known better.
    """
    learned = {name: diagnosis.quantities[name] for name in LEARNED_QUANTITIES}
    known = {name: estimate.value for name, estimate in learned.items() if estimate.known}
    if diagnosis.track_m.low <= diagnosis.odometry["track_m"] <= diagnosis.track_m.high:
        known.pop("track_m", None)
    odometry = {**recording.manifest.odometry, **known}
    return replace(recording, manifest=recording.manifest.model_copy(update={"odometry": odometry}))


def _symmetric(value: float, std: float) -> Estimate:
    return Estimate(value, value - Z95 * std, value + Z95 * std, std)


def _ratio(apart: float, std: float) -> Estimate:
    """Right over left from their difference over their mean, which is 2 or -2 where one wheel never counts."""
    apart = min(max(apart, -MAX_WHEEL_DIFFERENCE), MAX_WHEEL_DIFFERENCE)
    return _symmetric((1.0 + apart / 2.0) / (1.0 - apart / 2.0), std)


def _tell_stretches(recording: Recording, gaps: Gaps) -> tuple[StuckStretch, ...]:
    begin = float(recording.time[0])
    return tuple(
        StuckStretch(
            ("left", "right")[one.wheel],
            float(recording.time[one.first]) - begin,
            float(recording.time[one.last + 1]) - begin,
        )
        for one in gaps.stuck
    )
