"""The error field: predictions at each test position and heading, with the truth."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sim.errors import DamagedError, InputError
from sim.files.checksums import damaged, read_arrays, write_arrays
from sim.geometry import wrap

OPTIONAL_ARRAYS = "yaw", "yaw_std", "novelty", "radius", "radius_95", "accepted", "covariance", "reason"
"""Arrays that some methods have, in the file as ``<array>/<method>``."""
REPAIR_HINT = "deepgps run with the same scenario and --out measures the methods again"


@dataclass(frozen=True)
class ErrorField:
    """One method's error over the room."""

    truth: np.ndarray  # Test positions (C, 2) [m]
    heading: np.ndarray  # Test headings [rad], shared by all positions (H,) or separate for each (C, H)
    predicted: np.ndarray  # Aligned predictions (C, H, 2) [m]
    # Aligned predictions of the heading (C, H) [rad]; NaN for an image without; None: the method gives none
    yaw: np.ndarray | None = None
    # Its standard deviation, as the method estimates it (C, H) [rad]; None like ``yaw``
    yaw_std: np.ndarray | None = None
    # Error to be expected of each image (C, H) [m]; None: the method does not say
    novelty: np.ndarray | None = None
    # Radius around the prediction that holds the true position with a probability of 68 % (C, H) [m]; None: the
    # method gives none
    radius: np.ndarray | None = None
    radius_95: np.ndarray | None = None  # The same for 95 % (C, H) [m]; None like ``radius``
    accepted: np.ndarray | None = None  # Whether the method accepts each image (C, H) bool; None: it refuses none
    # Covariance of each prediction by its image alone (C, H, 2, 2) [m^2]; None: the method knows none
    covariance: np.ndarray | None = None
    # Why each image is refused (C, H): 0 accepted, 1 unlike, 2 ambiguous, 3 contradicting; None: it does not say
    reason: np.ndarray | None = None

    @property
    def error(self) -> np.ndarray:
        """Distance between prediction and truth (C, H) [m]."""
        return np.linalg.norm(self.predicted - self.truth[:, None], axis=-1)

    @property
    def yaw_error(self) -> np.ndarray | None:
        """Predicted minus true heading (C, H) [rad], from -pi to pi; None where the method estimates none."""
        return None if self.yaw is None else wrap(self.yaw - self.heading)

    @property
    def worst(self) -> np.ndarray:
        """The largest error over the headings of each position (C,) [m], the paper's measure (Sec. IV-B)."""
        return self.error.max(axis=1)

    @property
    def is_accepted(self) -> np.ndarray:
        """Whether each image is accepted (C, H) bool; a method that refuses none accepts all."""
        return np.ones(self.predicted.shape[:2], bool) if self.accepted is None else self.accepted


def find_rms(values: np.ndarray) -> float:
    """Root of the mean square of values (...)."""
    return float(np.sqrt(np.mean(values**2)))


def write_fields(path: Path, fields: Mapping[str, ErrorField]) -> None:
    """Write the error fields of several methods at the same places."""
    some = next(iter(fields.values()))
    arrays = {method: field.predicted for method, field in fields.items()}
    for method, field in fields.items():
        for part in OPTIONAL_ARRAYS:
            if (array := getattr(field, part)) is not None:
                arrays[f"{part}/{method}"] = array
    write_arrays(path, {"truth": some.truth, "heading": some.heading, **arrays})


@dataclass(frozen=True)
class WorstField:
    """One method's error field with only the worst heading of each test position."""

    truth: np.ndarray  # Test positions (C, 2) [m]
    predicted: np.ndarray  # Aligned prediction at the heading with the largest error, for each position (C, 2) [m]
    error: np.ndarray  # Its distance from the truth (C,) [m]
    heading: np.ndarray  # That heading (C,) [rad]
    radius: np.ndarray | None = None  # Radius of 68 % there (C,) [m]; None: the method gives none
    row: np.ndarray | None = None  # Numbers of position and heading in the error field (C, 2); None: there is none

    def take(self, chosen: np.ndarray | slice) -> "WorstField":
        """The field at some of its places."""
        return replace(self, **{name: part[chosen] for name, part in vars(self).items() if part is not None})


def read_fields(run: Path) -> dict[str, WorstField]:
    """Read error_field.npz: of each position the worst heading decides (paper, Sec. V)."""
    return {name: find_worst(field) for name, field in read_all_headings(run).items()}


def read_all_headings(run: Path, name: str = "error_field.npz") -> dict[str, ErrorField]:
    """Read error fields with the predictions at every heading; raises InputError if they are missing or damaged."""
    path = run / name
    if not path.is_file():
        raise InputError(f"{run} is no whole run: {name} is missing")
    try:
        data = read_arrays(path)
    except DamagedError as error:
        raise DamagedError(f"{error}; {REPAIR_HINT}") from None
    if missing := {"truth", "heading"} - set(data):
        raise damaged(path, f"it has no {' and no '.join(sorted(missing))}")
    truth, heading = data["truth"], data["heading"]
    return {
        name: ErrorField(truth, heading, predicted, *(data.get(f"{part}/{name}") for part in OPTIONAL_ARRAYS))
        for name, predicted in data.items()
        if name not in {"truth", "heading"} and "/" not in name
    }


def find_worst(field: ErrorField, among: np.ndarray | None = None) -> WorstField:
    """The largest error per position among some images (C, H) bool, or all; positions without any are left out."""
    among = np.ones(field.predicted.shape[:2], bool) if among is None else among
    cells = np.flatnonzero(among.any(axis=1))
    rows = cells, np.where(among, field.error, -1.0)[cells].argmax(axis=1)
    heading = np.broadcast_to(field.heading, among.shape)[rows]
    radius = None if field.radius is None else field.radius[rows]
    truth, predicted, error = field.truth[cells], field.predicted[rows], field.error[rows]
    return WorstField(truth, predicted, error, heading, radius, np.stack(rows, axis=1))


def split_by_acceptance(field: ErrorField) -> tuple[WorstField, WorstField]:
    """The worst accepted image of each position that has one, and the worst refused image of each that has one."""
    return find_worst(field, field.is_accepted), find_worst(field, ~field.is_accepted)
