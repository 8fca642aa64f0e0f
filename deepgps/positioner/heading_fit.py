"""Makes the table of headings from a trained method's own map: straight segments say which way the robot looked.

The direction of a straight line through the predicted positions of a segment, in the order driven, is the heading of
its images. The ground truth is not used.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from deepgps.data.segments import find_runs
from deepgps.positioner.headings import HeadingTable, correlate, take_phases
from deepgps.positioner.kriging import find_nearest
from sim.geometry import wrap
from sim.recording.format import Recording

CELL_M = 0.1  # The table has one image for each square of the map with sides of this length [m]
SURROUNDING_IMAGES, REACH_M = 16, 0.25
"""Training images around an entry from which its heading is refined, and the farthest of them [m]."""
MIN_ERROR_M = 0.005  # Least error that is taken for a predicted position [m]
PARALLAX_RAD_PER_M, MIN_ERROR_RAD = np.radians(20.0), np.radians(0.3)
"""Usual size of the parallax [rad / m], and least error of an angle between two images [rad]."""
MAX_HEADING_STD_RAD = np.radians(10.0)  # Images whose heading is known worse than this do not come into the table [rad]
CHECKED_IMAGES = 512  # Training images by which the standard deviation is scaled
CHUNK = 256


@dataclass(frozen=True)
class Lines:
    """What the straight segments of a drive tell of its N images; NaN where they tell nothing."""

    heading: np.ndarray  # Heading in the map (N,) [rad]
    std: np.ndarray  # Its standard deviation (N,) [rad]
    # RMS distance of the segment's predictions from a straight line with the distances driven (N,) [m]
    residual_m: np.ndarray


def make_headings(recording: Recording, positions: np.ndarray) -> HeadingTable | None:
    """Make the table of headings from a method's predictions (N, 2) [m] of all training images.

    None where observations are no polar images or no segment shows a heading.
    """
    if recording.kind != "polar_image" or recording.observation.shape[2] < 8:
        return None
    lines = fit_lines(recording, positions)
    able = np.flatnonzero(lines.std < MAX_HEADING_STD_RAD)
    able = np.concatenate([able[:0], *(part[_show_direction(recording, part)] for part in _split(able))])
    if len(able) < 2:
        return None
    place, heading, std = positions[able], lines.heading[able], lines.std[able]
    entry = thin_out(place, CELL_M)
    distance, around = find_nearest(KDTree(place), place[entry], SURROUNDING_IMAGES)
    # of a million images, only those of the table and around its entries are in memory
    used, row = np.unique(np.column_stack([entry, around]), return_inverse=True)
    row = row.reshape(len(entry), -1)
    phases = np.concatenate([take_phases(recording.observation[part]) for part in _split(able[used])])
    own = phases[row[:, 0]]
    largest = np.maximum(np.abs(own.real), np.abs(own.imag)).max(axis=(1, 2), keepdims=True)
    spectrum = np.rint(np.stack([own.real, own.imag], axis=-1) / largest[..., None] * 127.0).astype(np.int8)
    angle = np.concatenate(
        [_turn_to(phases, row[k : k + CHUNK, 0], row[k : k + CHUNK, 1:]) for k in range(0, len(entry), CHUNK)]
    )
    turned = wrap(heading[around] - heading[entry, None])
    near = (distance < REACH_M) & (around != entry[:, None])
    chirality = 1 if (np.sin(turned) * np.sin(angle))[near].sum() >= 0.0 else -1
    off, parallax = _refine(
        wrap(turned - chirality * angle), place[around] - place[entry, None], std[around], std[entry], near
    )
    squared = np.where(distance < REACH_M, lines.residual_m[able][around] ** 2, np.nan)  # an entry is near itself
    table = HeadingTable(
        spectrum,
        place[entry].astype(np.float32),
        wrap(heading[entry] + off).astype(np.float32),
        parallax.astype(np.float32),
        np.sqrt(np.nanmean(squared, axis=1)).astype(np.float32),
        chirality,
        1.0,
    )
    others = np.setdiff1d(np.arange(len(able)), entry)
    others = others[:: max(1, len(others) // CHECKED_IMAGES)]
    return _scale_std(table, recording.observation[able[others]], place[others], heading[others])


def _split(index: np.ndarray) -> list[np.ndarray]:
    return np.array_split(index, -(-len(index) // CHUNK)) if len(index) else []


def _show_direction(recording: Recording, index: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(take_phases(recording.observation[index])).any(axis=(1, 2)))


def fit_lines(recording: Recording, positions: np.ndarray) -> Lines:
    """Fit a straight line to the predictions (N, 2) [m] of each segment, along which images are evenly spaced.

    No tick is read: methods that learn from none share their weights. Observations that belong to two segments are left
    out, since the robot has turned there.
    """
    uses = np.bincount(recording.reading[:, 1], minlength=len(positions))
    heading, std, residual = (np.full(len(positions), np.nan) for _ in range(3))
    for run in find_runs(recording):
        index = recording.reading[run, 1]
        number, place = index - index.mean(), positions[index] - positions[index].mean(axis=0)
        x, y = number @ place
        if len(run) < 2 or not np.hypot(x, y):
            continue
        left = np.array([-y, x]) / np.hypot(x, y)
        square = ((place @ left) ** 2).sum() / max(len(run) - 2, 1)  # across, the line has two unknowns
        length = np.hypot(x, y) / np.sqrt((number**2).sum())
        alone = index[uses[index] == 1]
        heading[alone] = np.arctan2(y, x)
        std[alone] = np.sqrt(square + MIN_ERROR_M**2) / length
        residual[alone] = np.sqrt(square)
    return Lines(heading, std, residual)


def thin_out(place: np.ndarray, cell_m: float) -> np.ndarray:
    """Of places (n, 2) [m] the one nearest to the middle of each square with sides ``cell_m``, as indices (E,)."""
    cell = np.floor(place / cell_m)
    away = ((place / cell_m - cell - 0.5) ** 2).sum(axis=1)
    order = np.lexsort((away, cell[:, 1], cell[:, 0]))
    new = np.diff(cell[order], axis=0, prepend=np.nan).any(axis=1)
    return order[new]


def _turn_to(phases: np.ndarray, entry: np.ndarray, around: np.ndarray) -> np.ndarray:
    return -correlate(phases[around], phases[entry])[0][..., 0]


def _refine(
    off: np.ndarray, away: np.ndarray, std: np.ndarray, own_std: np.ndarray, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Correction of the entries' headings (E,) [rad] and their parallax (E, 2) [rad / m].

    Least squares with Cauchy weights: off = correction + parallax . away, near a correction and a parallax of zero.
    ``off`` is the heading by an image around an entry minus the entry's own (E, M) [rad], ``away`` its place against
    the entry's (E, M, 2) [m]; ``std`` (E, M) and ``own_std`` (E,) [rad] are those of the two headings, ``near`` which
    images count.
    """
    rows = np.concatenate([np.ones((*off.shape, 1)), away], axis=2)
    prior = np.zeros((len(off), 3, 3))
    prior[:, 0, 0] = own_std**-2
    prior[:, 1, 1] = prior[:, 2, 2] = PARALLAX_RAD_PER_M**-2
    found = np.zeros((len(off), 3))
    for _ in range(8):
        missed = wrap(off - np.einsum("emk,ek->em", rows, found))
        middle = _median(np.abs(missed), near)
        scale = np.maximum(1.5 * np.asarray(middle), MIN_ERROR_RAD)[..., None]
        weight = near / (std**2 + scale**2) / (1.0 + (missed / (2.0 * scale)) ** 2)
        target = missed + np.einsum("emk,ek->em", rows, found)
        matrix = np.einsum("em,emk,eml->ekl", weight, rows, rows) + prior
        found = np.linalg.solve(matrix, np.einsum("em,em,emk->ek", weight, target, rows)[..., None])[..., 0]
    return found[:, 0], found[:, 1:]


def _scale_std(table: HeadingTable, images: np.ndarray, place: np.ndarray, heading: np.ndarray) -> HeadingTable:
    """Set the factor by which errors exceed spreads, on training images that are not in the table."""
    found = table.find(images, place)
    ratio = np.abs(wrap(found.yaw[:, 0] - heading)) / found.std[:, 0]
    ratio = ratio[np.isfinite(ratio)]
    factor = float(np.sqrt(np.mean(np.minimum(ratio, 3.0) ** 2))) if len(ratio) else 1.0
    return replace(table, std_factor=factor)


def _median(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Median of those values of each row (E, M) that count; 0 where none does."""
    some = counted.any(axis=1)
    found = np.zeros(len(values))
    found[some] = np.nanmedian(np.where(counted, values, np.nan)[some], axis=1)
    return found
