"""DeepGPS and registration in one file: an image becomes a position, learned from images and driven distances alone.

    python deepgps_from_scratch.py RUN/recording [map.svg]

It needs numpy, scipy and torch. What it reads of a recording of N images, R readings and a test grid of C positions:

    manifest.json             "odometry": "wheel_radius_m" and "ticks_per_rev"
    observations/fisheye.npy  the images, unrolled around the zenith: (N, rings, sectors, 3) uint8
    reading.npy               straight segment, image, ticks of the left and of the right wheel: (R, 4) integers
    test/fisheye.npy          images of the test grid at H headings: (C, H, rings, sectors, 3) uint8
    truth/pose.npy, truth/test_pose.npy    x, y [m] and yaw: (N, 3), (C, H, 3), for the errors at the end alone

Equations are the paper's; what is marked "ours" leads its loss to the right one of many minima, or does without it.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from scipy.linalg import eigh, solve
from scipy.sparse import block_array, csr_array, diags_array, eye_array, hstack
from scipy.spatial import KDTree
from torch import nn
from torch.nn.utils.rnn import pad_sequence

FREQUENCIES, PRINCIPAL, COMPONENTS = 16, 256, 64  # of the features
NEIGHBOURS, MAX_STEPS = 3, 2.0  # loop closures of an image, and their greatest length in steps between readings
MODES, ROUNDS = (2, 3), 30  # of the initial map: numbers of slow modes to try, rounds in which bars are moved
STEPS, SEGMENTS, SAMPLES = 1000, 16, 8  # optimiser's steps; segments in a batch, readings drawn from each
WIDTH, LAYERS, NOISE, RATE = 256, 4, 0.15, 2e-3  # of the network: neurons, layers, noise of its input, learning rate
IMITATION, SLACK_M, STRAIGHT = 0.2, 0.03, 5.0  # share of imitation, free distance from the map, weight of straightness
IMAGES, LENGTH_M, NUGGET = 12, 0.4, 0.02  # of kriging: images around, length of its covariance, variance of noise
STARTS, DISTANCE_M, TRIES, STEP_M = 8, 0.4, 6, 0.15  # of a registration: starts, their distance, steps, longest one


# 1. The recording: images, and the distances that the wheels measured along straight segments.
def read_recording(folder: Path) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Images (N, rings, sectors, 3); for each segment its images (n,) and their distances from its start (n,) [m]."""
    odometry = json.loads((folder / "manifest.json").read_text())["odometry"]
    images = np.load(folder / "observations" / "fisheye.npy")
    segment, image, left, right = np.load(folder / "reading.npy").T
    driven = 2.0 * np.pi * odometry["wheel_radius_m"] / odometry["ticks_per_rev"] * (left + right) / 2.0
    runs = [run for run in np.split(np.arange(len(segment)), np.flatnonzero(np.diff(segment)) + 1) if len(run) > 1]
    return images, [image[run] for run in runs], [np.abs(driven[run] - driven[run[0]]) for run in runs]


# 2. Features (ours): what of an image stays as it is when the robot turns, and changes slowly while it drives.
def describe(images: np.ndarray) -> np.ndarray:
    """Spectra (N, K) around the circle: a turn of the robot changes no magnitude, no phase difference of two rings."""
    wave = np.fft.rfft(images.astype(np.float32) / 255.0, axis=2, norm="forward")[:, :, : FREQUENCIES + 1]
    product = wave[:, :-1, 1:].conj() * wave[:, 1:, 1:]
    product /= np.abs(product) ** 0.75 + 1e-6
    parts = (np.sqrt(np.abs(wave)), product.real, product.imag)
    return np.concatenate([part.reshape(len(images), -1) for part in parts], axis=1).astype(np.float32)


def fit_features(described: np.ndarray, segments: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (K,), basis (K, COMPONENTS) and noise (COMPONENTS,) of slow features (Wiskott and Sejnowski 2002): among the
    principal components, those that vary most over the drive and bend least from reading to reading."""
    mean = described.mean(axis=0)
    basis = torch.svd_lowrank(torch.from_numpy(described - mean), min(PRINCIPAL, len(described)), niter=3)[2].numpy()
    x = (described - mean).astype(float) @ basis
    bend = np.concatenate([x[one[:-2]] - 2.0 * x[one[1:-1]] + x[one[2:]] for one in segments])
    noise = bend.T @ bend / len(bend)
    ratio, axes = eigh(x.T @ x / len(x), noise + 1e-6 * np.trace(noise) / len(noise) * np.eye(len(noise)))
    slow = (axes * np.maximum(ratio, 1e-12) ** 0.25)[:, ::-1][:, :COMPONENTS]
    slow = (slow / np.sqrt(np.mean((x @ slow) ** 2))).astype(np.float32)
    return mean, basis @ slow, (bend @ slow).std(axis=0)


# 3. The initial map (ours): segments are rigid bars, which loop closures hold together.
def find_closures(features: np.ndarray, segments: list, along: list, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (P, 2) of images of different segments, each among the other's most similar, and the distances (P,) [m] of
    each pair, by how fast the features change along the segments there."""
    apart = torch.cdist(torch.from_numpy(features), torch.from_numpy(features)).numpy()
    rate = np.full(len(features), np.nan, np.float32)  # of an image on no segment, which is near to none
    for one, distance in zip(segments, along, strict=True):
        rate[one] = np.linalg.norm(np.gradient(features[one], distance, axis=0), axis=1)
        apart[np.ix_(one, one)] = np.inf
    apart /= (rate[:, None] + rate) / 2.0
    near = apart <= np.partition(apart, NEIGHBOURS, axis=1)[:, NEIGHBOURS - 1 : NEIGHBOURS]
    pairs = np.argwhere(np.triu(near & near.T & (apart < MAX_STEPS * step)))
    return pairs, apart[*pairs.T]


@dataclass
class Bars:
    """Segments as rigid bars: a reading lies at its bar's middle plus its offset along the bar's direction."""

    owner: csr_array  # 1 at the bar of each reading (R, bars)
    offset: csr_array  # from this bar's middle, likewise (R, bars) [m]
    joint: csr_array  # 1 and -1 at the two readings of each joint (J, R)
    free: np.ndarray  # distance of these two that costs nothing (J,) [m]


def join_bars(segments: list, along: list, pairs: np.ndarray, apart: np.ndarray) -> Bars:
    """Bars of all segments, joined where they share an image, at a turn, and at loop closures."""
    image, offset = np.concatenate(segments), np.concatenate([one - one.mean() for one in along])
    bar = np.repeat(np.arange(len(segments)), [len(one) for one in segments])
    owner, pick = eye_array(len(segments), format="csr")[bar], eye_array(len(image), format="csr")
    reading = np.zeros(image.max() + 1, int)
    reading[image] = np.arange(len(image))
    turn = np.flatnonzero(image[1:] == image[:-1])
    a, b = np.concatenate([reading[pairs], np.stack([turn, turn + 1], axis=1)]).T
    return Bars(owner, diags_array(offset) @ owner, pick[a] - pick[b], np.append(apart, np.zeros(len(turn))))


def map_by_straightness(bars: Bars, modes: int) -> np.ndarray:
    """Rough positions (R, 2) [m]. If enough bars cross, a function that is linear along each bar and continuous where
    bars meet is an affine function of the position: a slow mode. Directions of unit length leave a rigid motion."""
    count = bars.owner.shape[1]
    differ = bars.joint @ hstack([bars.owner, bars.offset])
    normal = (differ.T @ differ).toarray()
    middle, slope, mixed = normal.diagonal()[:count], normal.diagonal()[count:], normal.diagonal(count)
    firm = np.maximum(slope - mixed**2 / np.maximum(middle, 1e-9), 0.0)  # how well joints hold a bar's slope
    normal += 1e-9 * np.trace(normal) / len(normal) * np.eye(len(normal))
    slowest = (len(normal) - modes, len(normal) - 1)
    middle, slope = np.split(eigh(np.diag(np.r_[np.zeros(count), firm]), normal, subset_by_index=slowest)[1], 2)
    i, j = np.triu_indices(modes)
    products, weight = slope[:, i] * slope[:, j] * np.where(i == j, 1.0, 2.0), np.sqrt(firm)
    metric = np.zeros((modes, modes))  # |slope @ plane| = 1, where plane @ plane.T = metric
    metric[i, j] = metric[j, i] = np.linalg.lstsq(products * weight[:, None], weight, rcond=None)[0]
    size, axes = np.linalg.eigh(metric)
    plane = (axes * np.sqrt(np.maximum(size, 0.0)))[:, -2:]
    return bars.owner @ middle @ plane + bars.offset @ slope @ plane


def relax(bars: Bars, places: np.ndarray, step: float) -> tuple[np.ndarray, float]:
    """Positions (R, 2) [m] of rigid bars that fit the joints, by Gauss-Newton with robust weights, and the misfit."""
    middle = (bars.owner.T @ places) / bars.owner.sum(axis=0)[:, None]
    angle = np.arctan2(*(bars.offset.T @ places).T[::-1])
    shift, turn = bars.joint @ bars.owner, bars.joint @ bars.offset
    for scale in step * np.maximum(16.0 * 0.75 ** np.arange(ROUNDS), 0.5):  # far joints pull too at first
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        gap = shift @ middle + turn @ direction
        gap *= np.maximum(0.0, 1.0 - bars.free / np.maximum(np.linalg.norm(gap, axis=1), 1e-9))[:, None]
        relative = (gap**2).sum(axis=1) / scale**2
        across, up = diags_array(-direction[:, 1]), diags_array(direction[:, 0])
        jacobian = block_array([[shift, None, turn @ across], [None, shift, turn @ up]])
        weighted = jacobian.T @ diags_array(np.tile(1.0 / (1.0 + relative) ** 2, 2))
        normal = (weighted @ jacobian).toarray()
        normal += 1e-3 * np.trace(normal) / len(normal) * np.eye(len(normal))
        change = solve(normal, -weighted @ gap.T.ravel(), assume_a="pos").reshape(3, -1)
        middle, angle = middle + change[:2].T, angle + np.clip(change[2], -0.5, 0.5)
    return bars.owner @ middle + bars.offset @ direction, float((relative / (1.0 + relative)).mean())


def find_initial_map(features: np.ndarray, segments: list, along: list) -> np.ndarray:
    """Positions (N, 2) [m] of the images on segments: of the maps by two and by more modes, the one that fits best."""
    step = float(np.median(np.concatenate([np.diff(one) for one in along])))
    bars = join_bars(segments, along, *find_closures(features, segments, along, step))
    places = np.zeros((len(features), 2), np.float32)
    maps = (relax(bars, map_by_straightness(bars, modes), step) for modes in MODES)
    places[np.concatenate(segments)] = min(maps, key=lambda one: one[1])[0]
    return places


# 4. The network, its loss, and gradient descent.
def train(features: torch.Tensor, known: torch.Tensor, segments: list, along: list) -> nn.Module:
    """A network from features (N, COMPONENTS) to positions (N, 2) [m], which begins at the positions ``known``."""
    sizes = pairwise([features.shape[1]] + [WIDTH] * LAYERS)
    layers = [part for a, b in sizes for part in (nn.Linear(a, b), nn.GELU())]
    network = nn.Sequential(*layers, nn.Linear(WIDTH, 2))
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, STEPS, pct_start=0.05)
    count = torch.tensor([len(one) for one in segments])
    image, driven = (pad_sequence([*map(torch.from_numpy, some)], batch_first=True) for some in (segments, along))
    for step in range(STEPS):
        row = torch.multinomial(count.float(), SEGMENTS, replacement=True)[:, None]
        column = (torch.rand(SEGMENTS, SAMPLES) * count[row]).long()
        index, c = image[row, column], driven[row, column].float()
        p = network(features[index] + NOISE * torch.randn(*index.shape, features.shape[1]))
        away = (p - known[index]).norm(dim=2)
        loss = distances(p, c) + STRAIGHT * straightness(p, c) + nn.functional.relu(away - SLACK_M).mean()
        pull = max(0.0, 1.0 - step / STEPS / IMITATION)
        loss = (1.0 - pull) * loss + pull * away.mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
    return network


def distances(p: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
    """Mean of |d - c| (Eq. 2) over all pairs of readings of a segment (Eq. 5): p (S, m, 2) [m], c (S, m) [m]."""
    i, j = torch.triu_indices(p.shape[1], p.shape[1], 1)
    return ((p[:, i] - p[:, j]).square().sum(dim=2).add(1e-12).sqrt() - (c[:, i] - c[:, j]).abs()).abs().mean()


def straightness(p: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
    """Mean distance from the straight line driven (ours): a small bend hardly changes any d."""
    p, c = p - p.mean(dim=1, keepdim=True), c - c.mean(dim=1, keepdim=True)
    line = nn.functional.normalize((c[:, :, None] * p).sum(dim=1, keepdim=True), dim=2)
    return (p - c[:, :, None] * line).square().sum(dim=2).add(1e-12).sqrt().mean()


# 5. Registration (ours), in place of the network: where on the map would the image be seen?
def register(features: np.ndarray, known: np.ndarray, places: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Positions (n, 2) [m] of images with features (n, COMPONENTS), on a map of images with features and positions
    (N, ...): the best of those found from several starts, which lie apart. Noise of the features: (COMPONENTS,)."""
    apart, rows = torch.cdist(*map(torch.from_numpy, (features, known))), np.arange(len(features))
    near = apart.topk(16 * STARTS, largest=False).indices.numpy()
    free, best, found = np.ones(near.shape, bool), np.full(len(near), np.inf), np.zeros((len(near), 2))
    for _ in range(STARTS):
        start = places[near[rows, free.argmax(axis=1)]]
        free &= np.linalg.norm(places[near] - start[:, None], axis=2) > DISTANCE_M
        place, misfit = refine(start, features / noise, known / noise, places)
        better = misfit < best
        best[better], found[better] = misfit[better], place[better]
    return found


def refine(place: np.ndarray, x: np.ndarray, known: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 2) [m] near the given ones at which features x fit better, by Gauss-Newton, and the misfit (n,)."""
    tree = KDTree(places)
    for step in range(TRIES + 1):
        around = tree.query(place, IMAGES)[1]
        seen = np.swapaxes(known[around], 1, 2) @ krige(place, places[around])
        differ, slope = x[:, :, None] - seen[:, :, :1], seen[:, :, 1:]
        if step < TRIES:
            move = np.linalg.solve(np.swapaxes(slope, 1, 2) @ slope, np.swapaxes(slope, 1, 2) @ differ)[:, :, 0]
            place = place + move * np.minimum(1.0, STEP_M / np.linalg.norm(move, axis=1, keepdims=True))
    return place, (differ**2).sum(axis=(1, 2))


def krige(place: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Weights by which features at a place (n, 2) [m] follow from those at others (n, k, 2) around it, with the
    derivatives of the weights by x and y (n, k, 3). The covariance is Matern's with smoothness 3/2."""
    rate, away = np.sqrt(3.0) / LENGTH_M, places - place[:, None]
    apart = rate * np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
    here = rate * np.linalg.norm(away, axis=2)[..., None]
    known = np.concatenate([1.0 + here, rate**2 * away], axis=2) * np.exp(-here)
    return np.linalg.solve((1.0 + apart) * np.exp(-apart) + NUGGET * np.eye(IMAGES), known)


# 6. The truth, for the errors alone: distances leave open how the map is shifted, turned and mirrored.
def align(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation or reflection (2, 2) and shift (2,) from positions (N, 2) to others, robustly (Kabsch 1976)."""
    weight = np.ones(len(source))
    for _ in range(20):
        a, b = (np.average(points, axis=0, weights=weight) for points in (source, target))
        u, _, v = np.linalg.svd((target - b).T @ (weight[:, None] * (source - a)))
        error = np.linalg.norm((source - a) @ (u @ v).T + b - target, axis=1)
        weight = 1.0 / (1.0 + (error / (4.0 * np.median(error))) ** 2)
    return u @ v, b - u @ v @ a


def measure(folder: Path, locate: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Test positions (C, 2) [m], and where the worst of their images is put (C, 2) once training images are aligned."""
    test, true = np.load(folder / "test" / "fisheye.npy"), np.load(folder / "truth" / "test_pose.npy")[:, :, :2]
    images, pose = np.load(folder / "observations" / "fisheye.npy"), np.load(folder / "truth" / "pose.npy")
    rotation, shift = align(locate(images[::4]), pose[::4, :2])
    found = (locate(test.reshape(-1, *test.shape[2:])) @ rotation.T + shift).reshape(true.shape)
    worst = np.linalg.norm(found - true, axis=2).argmax(axis=1)
    return true[:, 0], found[np.arange(len(found)), worst]


def draw(path: Path, true: np.ndarray, found: np.ndarray) -> None:
    """Draw a dot at each test position (C, 2) [m] and a line from it to where it was found, as SVG in centimetres."""
    at, to = (some * [100.0, -100.0] for some in (true, found))
    lines = "".join(f"M{x:.0f} {y:.0f}l{u:.0f} {v:.0f}" for x, y, u, v in np.hstack([at, to - at]))
    box = " ".join(f"{number:.0f}" for number in (*at.min(axis=0) - 20.0, *np.ptp(at, axis=0) + 40.0))
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" style="background:#fff" stroke="#0a5ea8"'
    path.write_text(f'{svg} stroke-width="3" stroke-linecap="round"><path d="{lines}"/></svg>\n')


def learn(folder: Path) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Learn from a recording; functions from images (n, rings, sectors, 3) to positions (n, 2) [m]."""
    images, segments, along = read_recording(folder)
    torch.manual_seed(0)
    described = describe(images)
    mean, basis, noise = fit_features(described, segments)
    features = (described - mean) @ basis
    known = find_initial_map(features, segments, along)
    network = train(torch.from_numpy(features), torch.from_numpy(known), segments, along)
    on = np.unique(np.concatenate(segments))
    methods = {
        "network": lambda x: network(torch.from_numpy(x)).detach().numpy(),
        "nearest image": lambda x: known[on][torch.cdist(*map(torch.from_numpy, (x, features[on]))).argmin(dim=1)],
        "registration": lambda x: register(x, features[on], known[on], noise),
    }
    return {name: lambda some, of=of: of((describe(some) - mean) @ basis) for name, of in methods.items()}


if __name__ == "__main__":
    folder, *picture = map(Path, sys.argv[1:])
    torch.set_num_threads(1)  # of which so small a network needs no more
    for name, locate in learn(folder).items():
        true, found = measure(folder, locate)
        error = 100.0 * np.linalg.norm(found - true, axis=1)
        print(f"{name}: RMS {np.sqrt(np.mean(error**2)):.1f} cm, median {np.median(error):.1f}, max {error.max():.0f}")
    draw(*picture or [Path("map.svg")], true, found)
