"""The report "mds": the distances that a network learned, and the map that classical scaling makes of them.

The paper explains why DeepGPS works (Sec. III-A): the loss supervises a function of two observations that predicts how
far apart they were taken. Multidimensional scaling makes a map from the distances between all positions of a grid, and
the network does that implicitly. With two outputs, the last step is algebra: the distances between points of a plane
determine the points. Two claims may fail: that distances are right where no straight segment ever joined two positions,
and that a distance function that is free to use more than two dimensions needs only two.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Picture
from scipy.spatial.distance import pdist, squareform

from deepgps.config.methods import folder_of
from deepgps.initial_map.distances.isomap import find_axes
from deepgps.positioner.positioner import NetworkPositioner
from deepgps.positioner.stored_positioner import load_positioner
from deepgps.studies.table import Row, choices, describe, is_seed, split_by_label
from sim.alignment import fit_alignment
from sim.errors import InputError
from sim.geometry import FreeSpace
from sim.recording.format import open_recording, open_truth

POSITIONS = 1500  # Maximum number of grid positions for scaling
MAX_PAIRED = 250  # Maximum number of positions among which all pairs are evaluated
EIGENVALUES = 10  # Number of eigenvalues that are kept
COLOURS = ("#0b62d6", "#1a936f", "#e07b00", "#c2255c", "#7a4fbf", "#4b5563")


@dataclass(frozen=True)
class Distances:
    """The distances that a network predicts between positions of the test grid."""

    truth: np.ndarray  # True positions (n, 2) [m]
    own: np.ndarray  # The network's own predictions of them (n, 2) [m], aligned
    scaled: np.ndarray  # The map by classical scaling (n, 2) [m], aligned
    dimensions: int  # Number of outputs of the network
    eigenvalues: np.ndarray  # The largest eigenvalues of the centred squared distances, descending [m^2]
    planar: float  # Share of the two largest eigenvalues in the sum of all absolute eigenvalues
    true: np.ndarray  # True distance of each pair (p,) [m]
    predicted: np.ndarray  # The network's distance of each pair (p,) [m]
    joined: np.ndarray  # Whether the robot could drive between the two positions of a pair in a straight line (p,)


def add_distances(run: Path, row: Row) -> Row:
    """Columns for the errors of the distances and of the map made from them."""
    found = find_distances(run, row["method"])
    error = np.abs(found.predicted - found.true)
    return {
        "outputs": found.dimensions,
        "planar": found.planar,
        "own_m": _rms(found.own - found.truth),
        "mds_m": _rms(found.scaled - found.truth),
        "mds_own_m": _rms(fit_alignment(found.scaled, found.own, "E2").apply(found.scaled) - found.own),
        "joined_m": _median(error[found.joined]),
        "unjoined_m": _median(error[~found.joined]),
    }


def find_distances(run: Path, method: str) -> Distances:
    """Predict the distances between positions of the test grid with a trained network, and scale them."""
    positioner = load_positioner(folder_of(run, method))
    if not isinstance(positioner, NetworkPositioner):
        raise InputError(f"{folder_of(run, method)}: {method} has no network that could predict distances")
    recording, truth = open_recording(run / "recording"), open_truth(run / "recording")
    some = _spread(len(recording.test_observation), POSITIONS)
    place = truth.test_pose[some, 0, :2]
    out = positioner.embed(recording.test_observation[some, 0])
    distance = squareform(pdist(out))
    scaled, eigenvalues, planar = scale_all(distance)
    own = out @ positioner.axes.double().numpy()
    few = _spread(len(some), MAX_PAIRED)
    first, second = (few[index] for index in np.triu_indices(len(few), 1))
    return Distances(
        truth=place,
        own=fit_alignment(own, place, "E2").apply(own),
        scaled=fit_alignment(scaled, place, "E2").apply(scaled),
        dimensions=out.shape[1],
        eigenvalues=eigenvalues,
        planar=planar,
        true=np.linalg.norm(place[first] - place[second], axis=1),
        predicted=distance[first, second],
        joined=are_joined(truth.free_space, place[first], place[second]),
    )


def scale_all(distance: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Classical multidimensional scaling of all distances (n, n) [m] to a plane.

    Returns the map (n, 2) [m]; the largest eigenvalues, descending [m^2]; the share of the two largest in the sum of
    all absolute eigenvalues.
    """
    size, axes = (part[..., ::-1] for part in find_axes(distance))
    total = max(float(np.abs(size).sum()), 1e-300)
    place = axes[:, :2] * np.sqrt(size[:2].clip(min=0.0))
    return place, size[:EIGENVALUES], float(size[:2].sum()) / total


def are_joined(space: FreeSpace, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether the robot could drive straight from ``first`` to ``second`` (p, 2) [m]."""
    longest = float(np.linalg.norm(second - first, axis=1).max(initial=0.0))
    joined = np.ones(len(first), bool)
    for share in np.linspace(0.0, 1.0, int(np.ceil(longest / space.cell_m)) + 1):
        joined &= space.is_reachable(first + share * (second - first))
    return joined


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw eigenvalues, errors of distances, and maps, of the first run of each way of learning."""
    names = [*choices(rows, [name for name in varied if not is_seed(name)]), "method"]
    groups = split_by_label(rows, lambda row: describe(row, names))
    found = {title: find_distances(folder / "runs" / row["run"], row["method"]) for title, (row, *_) in groups.items()}
    picture = Picture(figsize=(max(9.6, 3.4 * len(found)), 7.2), layout="constrained")
    upper, lower = picture.subfigures(2, 1, squeeze=False, height_ratios=(1.15, 1))[:, 0]
    spectrum, errors = upper.subplots(1, 2)
    _draw_spectrum(spectrum, found)
    _draw_errors(errors, found)
    panels = lower.subplots(1, len(found), squeeze=False, sharex=True, sharey=True)[0]
    for axes, (title, one) in zip(panels, found.items(), strict=True):
        _draw_map(axes, one)
        axes.set_title(title, fontsize=9)
    panels[0].set_ylabel("y [m]")
    lower.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", frameon=False, fontsize=8, ncols=3)
    return picture


def _draw_spectrum(axes: Axes, found: Mapping[str, Distances]) -> None:
    for (title, one), colour in zip(found.items(), cycle(COLOURS), strict=False):
        share = (one.eigenvalues / one.eigenvalues[0]).clip(min=1e-8)
        axes.plot(np.arange(1, len(share) + 1), share, "o-", color=colour, label=title, markersize=4)
    axes.set(yscale="log", xlabel="eigenvalue", ylabel="relative to the largest", ylim=(0.5e-8, 2))
    axes.set_title("Are the distances planar?", fontsize=10)
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=7)


def _draw_errors(axes: Axes, found: Mapping[str, Distances]) -> None:
    for one, colour in zip(found.values(), cycle(COLOURS), strict=False):
        error, edges = np.abs(one.predicted - one.true), np.arange(0.0, one.true.max() + 0.5, 0.5)
        for joined, line in ((True, "-"), (False, "--")):
            kept = [(one.joined == joined) & (a <= one.true) & (one.true < a + 0.5) for a in edges]
            points = [
                (a + 0.25, 100 * np.median(error[chosen]))
                for a, chosen in zip(edges, kept, strict=True)
                if chosen.sum() > 9
            ]
            if points:
                axes.plot(*np.transpose(points), line, color=colour)
    axes.set(yscale="log", xlabel="true distance [m]", ylabel="median error of the distance [cm]")
    axes.yaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(ticker.NullFormatter())
    axes.set_title("Solid: a straight drive joins the pair; dashed: none does", fontsize=10)
    axes.grid(alpha=0.25, which="both")


def _draw_map(axes: Axes, one: Distances) -> None:
    axes.plot(*one.truth.T, ".", color="#c9ced6", markersize=3, label="truth")
    axes.plot(*one.own.T, "o", color="#0b62d6", mfc="none", markersize=2.6, markeredgewidth=0.4, label="network's own")
    axes.plot(*one.scaled.T, ".", color="#e8254f", markersize=1.2, label="MDS of its distances")
    axes.set(aspect="equal", xlabel="x [m]")
    axes.tick_params(labelsize=8)


def _spread(count: int, most: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _rms(away: np.ndarray) -> float:
    return float(np.sqrt((away**2).sum(axis=-1).mean()))


def _median(values: np.ndarray) -> float | None:
    return float(np.median(values)) if len(values) else None
