"""The methods by name, one record each. This module imports nothing heavy, so that settings and reports can use it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sim.alignment import AlignmentKind
from sim.errors import InputError
from sim.plugins import LOADING_HINT
from sim.recording.manifest import ObservationKind


@dataclass(frozen=True)
class Method:
    """The record of a method.

    Attributes:
        title: Its name in reports.
        colour: Colour of its lines in figures, "#rrggbb".
        alignment: Transform that evaluation fits: E2 if the method has a mirror ambiguity, else SE2.
        map: Where the positions come from that it learns: a map by compass, which needs images after turns; by
            distances alone; wheels; labels (tags', or the truth), which needs no encoders; or "own".
        estimator: How it finds an image's position on the map.
        fit: The function that trains it, or its name "module:function"; it takes a recording, settings, a seed, the
            method's folder and a progress callback, and returns a positioner with a record of its training.
        observes: The only kind of observation it takes; None: any.
        in_steps: Whether it trains step by step and reports its steps.
        predict: For a plugin's method whose ``fit`` returns arrays by name in place of a positioner: (these arrays,
            observations (B, ...)) -> positions (B, 2) [m].
    """

    title: str
    colour: str
    alignment: AlignmentKind
    fit: str | Callable[..., Any]
    map: str = "own"
    estimator: str = "own"
    observes: ObservationKind | None = None
    in_steps: bool = True
    predict: Callable[[Mapping[str, np.ndarray], np.ndarray], np.ndarray] | None = None

    @property
    def is_baseline(self) -> bool:
        """Whether it is there to be compared with: it is given positions, or is of older work."""
        return self.map not in {"compass", "distances", "own"} or self.estimator in {"linear", "trilateration"}


METHODS: dict[str, Method] = {
    "registration": Method(
        "Registration",
        "#b3003b",
        "SE2",
        "deepgps.methods.registration:fit",
        "compass",
        "registration",
        observes="polar_image",
        in_steps=False,
    ),
    "deepgps_compass": Method(
        "DeepGPS, compass",
        "#00a5c8",
        "SE2",
        "deepgps.methods.compass:fit",
        "compass",
        "network",
        observes="polar_image",
    ),
    "registration_distances": Method(
        "Registration, distances",
        "#e0559b",
        "E2",
        "deepgps.methods.registration:fit_distances",
        "distances",
        "registration",
        in_steps=False,
    ),
    "deepgps": Method("DeepGPS", "#0b62d6", "E2", "deepgps.methods.deepgps:fit", "distances", "network"),
    "sfa_linear": Method(
        "Linear slow features", "#a0694b", "E2", "deepgps.methods.sfa_linear:fit", "distances", "linear", in_steps=False
    ),
    "explicit": Method(
        "Explicit positioning",
        "#7a4fbf",
        "E2",
        "deepgps.methods.explicit:fit",
        "distances",
        "trilateration",
        observes="vector",
        in_steps=False,
    ),
    "explicit_mds": Method(
        "Explicit, from MDS",
        "#9aa0a8",
        "E2",
        "deepgps.methods.explicit:fit_from_mds",
        "distances",
        "trilateration",
        observes="vector",
        in_steps=False,
    ),
    "dead_reckoned_labels": Method(
        "Odometry labels", "#2b2b2b", "SE2", "deepgps.methods.baselines:fit_dead_reckoned", "wheels", "network"
    ),
    "registration_labels": Method(
        "Registration, labels",
        "#e8c000",
        "SE2",
        "deepgps.methods.baselines:fit_registration",
        "labels",
        "registration",
        in_steps=False,
    ),
    "posenet": Method("PoseNet", "#e07b00", "SE2", "deepgps.methods.baselines:fit_posenet", "labels", "network"),
    "posenet_noisy": Method(
        "PoseNet, noisy labels", "#7a5c00", "SE2", "deepgps.methods.baselines:fit_posenet_noisy", "labels", "network"
    ),
    "knn": Method(
        "Nearest neighbour",
        "#1a936f",
        "SE2",
        "deepgps.methods.baselines:fit_knn",
        "labels",
        "nearest image",
        in_steps=False,
    ),
    "pca_knn": Method(
        "PCA + nearest neighbour",
        "#7fb800",
        "SE2",
        "deepgps.methods.baselines:fit_pca_knn",
        "labels",
        "nearest scan",
        observes="scan",
        in_steps=False,
    ),
}
"""The methods in the order of figures. Scenarios and studies can name every method that is added here.

``deepgps.config.plugins.load_plugins`` adds those of plugins: to this one table, as settings check themselves against
it wherever they are made.
"""


def find_method(name: str) -> Method:
    """The method of this name; raises InputError if it is a plugin's that is not loaded."""
    if name not in METHODS:
        raise InputError(f"method {name}: no plugin that is loaded defines it; {LOADING_HINT}")
    return METHODS[name]


def title_of(name: str) -> str:
    """A method's name in reports."""
    return METHODS[name].title if name in METHODS else name


def colour_of(name: str) -> str:
    """A method's colour in figures; grey for an unknown method."""
    return METHODS[name].colour if name in METHODS else "#555555"


def folder_of(run: Path, name: str) -> Path:
    """Folder of a method in a run."""
    return run / name
