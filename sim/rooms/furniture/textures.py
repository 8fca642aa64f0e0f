"""Procedural textures of surfaces such as wood, plaster and cloth, from an RNG: (rows, columns, 3) uint8.

A texture covers a complete face; a wall's texture is as large as the wall, so that nothing on it repeats. Everything is
computed element by element, without libraries whose sums depend on the number of threads: same seed, same bytes.
"""

import itertools
from collections.abc import Sequence

import numpy as np

Colour = Sequence[float] | np.ndarray  # Red, green, blue in [0, 1]
Shape = tuple[int, int]  # Rows and columns of a texture [px]


def noise(rng: np.random.Generator, shape: Shape, cells: tuple[float, float]) -> np.ndarray:
    """Return smooth value noise (rows, columns) in [0, 1] with about ``cells`` bumps down and across."""
    knots = rng.random((int(np.ceil(cells[0])) + 2, int(np.ceil(cells[1])) + 2))
    r, tr = _steps(shape[0], cells[0])
    c, tc = _steps(shape[1], cells[1])
    top = knots[r][:, c] * (1 - tc) + knots[r][:, c + 1] * tc
    bottom = knots[r + 1][:, c] * (1 - tc) + knots[r + 1][:, c + 1] * tc
    return top * (1 - tr)[:, None] + bottom * tr[:, None]


def clouds(rng: np.random.Generator, shape: Shape, cells: tuple[float, float], octaves: int = 4) -> np.ndarray:
    """Return fractal noise (rows, columns), about 0.5 +- 0.2; each octave is twice as fine and half as strong."""
    total, weight = np.zeros(shape), 0.0
    for octave in range(octaves):
        scale = 2.0**octave
        total += noise(rng, shape, (cells[0] * scale, cells[1] * scale)) / scale
        weight += 1.0 / scale
    return total / weight


def vivid(rng: np.random.Generator) -> np.ndarray:
    """Draw a strong colour (3,) in [0, 1], of any hue."""
    return _hue(rng.random(), rng.uniform(0.5, 0.9), rng.uniform(0.5, 0.95))


def muted(rng: np.random.Generator, hue: float | None = None) -> np.ndarray:
    """Draw a muted colour (3,) in [0, 1], as for walls and cloth, of the given hue in [0, 1) or of any."""
    return _hue(rng.random() if hue is None else hue, rng.uniform(0.15, 0.5), rng.uniform(0.5, 0.9))


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Round an image in [0, 1] to uint8."""
    return np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def wood(rng: np.random.Generator, shape: Shape, colour: Colour, planks: int = 1) -> np.ndarray:
    """Horizontal boards, each with its own tint and grain."""
    rows, columns = shape
    image = np.empty((rows, columns, 3))
    edges = np.linspace(0, rows, planks + 1).astype(int)
    for top, bottom in itertools.pairwise(edges):
        part = (int(bottom - top), columns)
        bend = clouds(rng, part, (1.5, 3), 2)
        rings = 0.5 + 0.5 * np.sin(2 * np.pi * (rng.uniform(3, 5) * bend + np.linspace(0, 2, part[0])[:, None]))
        grain = clouds(rng, part, (max(part[0] / 3, 2), 4), 2)
        tint = rng.uniform(0.82, 1.12)
        shade = tint * (0.74 + 0.2 * rings + 0.24 * grain)
        if planks > 1:
            shade[-1:] *= 0.55
        image[top:bottom] = shade[..., None] * np.asarray(colour)
    return to_bytes(image)


def plaster(
    rng: np.random.Generator,
    shape: Shape,
    colour: Colour,
    second: Colour | None = None,
    stains: int = 6,
    cracks: int = 3,
    depth: float = 0.3,
) -> np.ndarray:
    """Painted plaster: light and dark regions, regions of a second colour, some stains and a few cracks."""
    rows, columns = shape
    ratio = columns / rows
    shade = 1.0 + depth * 2.0 * (clouds(rng, shape, (2.2, 2.2 * ratio), 3) - 0.5)
    shade += 0.1 * (noise(rng, shape, (rows / 4, columns / 4)) - 0.5)
    mix = np.clip(2.5 * clouds(rng, shape, (1.3, 1.3 * ratio), 2) - 0.75, 0, 1)[..., None]
    image = shade[..., None] * (np.asarray(colour) * (1 - mix) + np.asarray(colour if second is None else second) * mix)
    for _ in range(stains):
        reach = rng.uniform(0.06, 0.25) * rows
        part, down, across = _window(rng, shape, 1.4 * reach)
        size = reach * (0.7 + 0.6 * noise(rng, (down.size, across.size), (3, 3)))
        inside = np.clip((size - np.hypot(down, across)) / (0.03 * rows), 0, 1)[..., None]
        image[part] *= 1.0 - inside * rng.uniform(0.05, 0.2) * (0.7, 0.9, 1.2)
    broken = np.zeros(shape, bool)
    for _ in range(cracks):
        _crack(rng, broken)
    return to_bytes(image * np.where(broken, 0.72, 1.0)[..., None])


def wallpaper(rng: np.random.Generator, shape: Shape, colour: Colour, second: Colour, stripes: int) -> np.ndarray:
    """Vertical stripes of uneven width, with scattered flowers of a second colour."""
    rows, columns = shape
    widths = rng.uniform(0.5, 1.5, 2 * stripes)
    edges = np.concatenate([[0], np.cumsum(widths) / widths.sum()]) * columns
    band = np.searchsorted(edges, np.arange(columns) + 0.5) % 2
    tint = rng.uniform(0.9, 1.1, 2 * stripes)[np.clip(np.searchsorted(edges, np.arange(columns) + 0.5) - 1, 0, None)]
    across = (band * 0.35 * tint)[None, :, None]
    image = np.asarray(colour) * (1 - across) + np.asarray(second) * across
    image = image * (0.88 + 0.24 * clouds(rng, shape, (1.5, 4), 3))[..., None]
    for _ in range(3 * stripes):
        reach, petals = rng.uniform(0.03, 0.06) * rows, rng.integers(4, 7)
        part, down, right = _window(rng, shape, reach)
        size = reach * (0.7 + 0.3 * np.cos(petals * np.arctan2(down, right)))
        inside = 0.75 * np.clip(size - np.hypot(down, right), 0, 1)[..., None]
        image[part] = image[part] * (1 - inside) + inside * np.asarray(second)
    return to_bytes(image)


def panel(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A panel of a suspended ceiling: speckled, with a dark seam on two of its edges."""
    shade = 0.84 + 0.06 * noise(rng, shape, (shape[0] / 2, shape[1] / 2))
    shade[:1], shade[:, :1] = 0.6, 0.6
    return to_bytes(shade[..., None] * np.array((1.0, 0.99, 0.96)))


def motif(rng: np.random.Generator, shape: Shape, colour: Colour, second: Colour) -> np.ndarray:
    """A motif of wallpaper without seams: waves of whole periods, cut at two levels."""
    rows, columns = shape
    v, u = (np.arange(size)[at] / size for size, at in ((rows, np.s_[:, None]), (columns, np.s_[None, :])))
    height = np.zeros(shape)
    for _ in range(4):
        down, across = rng.integers(-2, 3, 2)
        height += rng.uniform(0.5, 1.0) * np.cos(2 * np.pi * (down * v + across * u + rng.random()))
    low, high = np.quantile(height, [0.45, 0.75])
    mix = 0.4 * np.clip(3 * (height - low), 0, 1) + 0.5 * np.clip(3 * (height - high), 0, 1)
    return to_bytes(np.asarray(colour) * (1 - mix[..., None]) + np.asarray(second) * mix[..., None])


def brick(rng: np.random.Generator, shape: Shape, colour: Colour, courses: int, per_course: float) -> np.ndarray:
    """Bricks in running bond, each with its own tint, with large-scale variation from soot and light."""
    rows, columns = shape
    down = np.arange(rows) * courses / rows
    across = np.arange(columns) * per_course / columns
    course = down.astype(int)
    along = across[None, :] + 0.5 * (course % 2)[:, None]
    number = along.astype(int)
    tints = rng.uniform(0.7, 1.15, (courses + 1, int(per_course) + 3))
    hues = 1.0 + rng.uniform(-0.08, 0.08, (courses + 1, int(per_course) + 3, 3))
    image = (tints[course[:, None], number])[..., None] * hues[course[:, None], number] * np.asarray(colour)
    mortar = np.clip(np.maximum(0.16 - (down % 1.0)[:, None], 0.06 - along % 1.0) * 12, 0, 1)[..., None]
    image = image * (1 - mortar) + mortar * (0.72, 0.7, 0.66)
    return to_bytes(image * (0.7 + 0.6 * clouds(rng, shape, (2, 2 * columns / rows), 3))[..., None])


def tile(rng: np.random.Generator, shape: Shape, colour: Colour, second: Colour, grid: tuple[int, int]) -> np.ndarray:
    """Glazed tiles in ``grid`` rows and columns with grout; each tile has its own tint, some a second colour."""
    rows, columns = shape
    down, across = np.arange(rows) * grid[0] / rows, np.arange(columns) * grid[1] / columns
    r, c = down.astype(int)[:, None], across.astype(int)[None, :]
    chosen = (rng.random(grid) < 0.22)[r, c][..., None]
    image = np.where(chosen, np.asarray(second), np.asarray(colour)) * rng.uniform(0.86, 1.08, grid)[r, c][..., None]
    grout = np.maximum((down % 1.0 < 0.1)[:, None], (across % 1.0 < 0.1)[None, :])[..., None]
    image = np.where(grout, 0.62, image)
    return to_bytes(image * (0.85 + 0.3 * clouds(rng, shape, (2, 3), 2))[..., None])


def fabric(rng: np.random.Generator, shape: Shape, colour: Colour, second: Colour) -> np.ndarray:
    """Woven cloth, plain, striped or checked."""
    rows, columns = shape
    style = rng.integers(3)
    down = 0.5 + 0.5 * np.sin(2 * np.pi * rng.uniform(3, 7) * np.arange(rows) / rows)
    across = 0.5 + 0.5 * np.sin(2 * np.pi * rng.uniform(3, 7) * np.arange(columns) / columns)
    mix = (0.0, down[:, None] ** 3, down[:, None] * across[None, :])[style] * np.ones(shape) * 0.6
    image = np.asarray(colour) * (1 - mix[..., None]) + np.asarray(second) * mix[..., None]
    weave = 0.8 + 0.25 * clouds(rng, shape, (4, 4), 2) + 0.15 * noise(rng, shape, (rows / 3, columns / 3))
    return to_bytes(image * weave[..., None])


def carpet(rng: np.random.Generator, shape: Shape, colour: Colour, second: Colour, third: Colour) -> np.ndarray:
    """A rug with a border, corner pieces and a medallion."""
    rows, columns = shape
    down, across = np.mgrid[0:rows, 0:columns]
    v, u = (2 * down / rows - 1), (2 * across / columns - 1)
    edge = np.minimum(1 - np.abs(v), (1 - np.abs(u)) * columns / rows)
    figure = np.sin(rng.integers(4, 8) * np.pi * u) * np.sin(rng.integers(3, 6) * np.pi * v)
    radius = np.hypot(u * columns / rows, v) + 0.12 * np.cos(rng.integers(5, 9) * np.arctan2(v, u + 1e-9))
    image = np.where((figure > 0.35)[..., None], np.asarray(second), np.asarray(colour))
    image = np.where((radius < 0.62)[..., None], np.asarray(third), image)
    image = np.where((radius < 0.42)[..., None], np.asarray(second), image)
    image = np.where((edge < 0.2)[..., None], np.asarray(third), image)
    image = np.where((np.abs(edge - 0.11) < 0.04)[..., None], np.asarray(second), image)
    return to_bytes(image * (0.75 + 0.4 * noise(rng, shape, (rows / 2.5, columns / 2.5)))[..., None])


def folds(rng: np.random.Generator, shape: Shape, colour: Colour, second: Colour) -> np.ndarray:
    """A hanging curtain: vertical folds, sometimes printed with bands of a second colour."""
    rows, columns = shape
    bend = 0.3 * noise(rng, shape, (2, 4))
    phase = rng.uniform(5, 8) * (np.arange(columns) / columns)[None, :] + bend
    shade = 0.72 + 0.32 * (0.5 + 0.5 * np.sin(2 * np.pi * phase))
    bands = (np.sin(2 * np.pi * rng.integers(2, 6) * np.arange(rows) / rows + rng.uniform(0, 6)) > 0.55)[:, None]
    mix = (bands * rng.choice([0.0, 0.7]))[..., None]
    image = np.asarray(colour) * (1 - mix) + np.asarray(second) * mix
    return to_bytes(image * shade[..., None])


def fins(rng: np.random.Generator, shape: Shape, colour: Colour, count: int) -> np.ndarray:
    """Vertical fins or slats, as of a radiator, a vent or a roller door."""
    columns = shape[1]
    shade = 0.68 + 0.32 * np.abs(np.sin(np.pi * count * (np.arange(columns) + 0.5) / columns))
    image = shade[None, :, None] * np.asarray(colour) * np.ones((*shape, 1))
    return to_bytes(image * (0.95 + 0.1 * clouds(rng, shape, (2, 2), 2))[..., None])


def drawers(rng: np.random.Generator, shape: Shape, colour: Colour, count: int) -> np.ndarray:
    """Fronts of drawers, one above the other, each with a handle and a shaded joint."""
    rows, columns = shape
    v = (np.arange(rows) * count / rows % 1.0)[:, None]
    u = (np.arange(columns) / columns)[None, :]
    shade = np.where((v < 0.07) | (u < 0.05) | (u > 0.95), 0.55, 1.0)
    shade = np.where((np.abs(v - 0.4) < 0.07) & (np.abs(u - 0.5) < 0.16), 0.3, shade)
    return to_bytes((shade * (0.9 + 0.2 * clouds(rng, shape, (3, 3), 2)))[..., None] * np.asarray(colour))


def panels(rng: np.random.Generator, shape: Shape, colour: Colour, grid: tuple[int, int]) -> np.ndarray:
    """A panelled surface, as of a door: ``grid`` recessed fields, each with a lit and a shaded edge."""
    rows, columns = shape
    v = (np.arange(rows) * grid[0] / rows % 1.0)[:, None]
    u = (np.arange(columns) * grid[1] / columns % 1.0)[None, :]
    inside = (v > 0.12) & (v < 0.88) & (u > 0.2) & (u < 0.8)
    shade = np.where(inside, 0.9, 1.0)
    shade = np.where(inside & ((v < 0.17) | (u < 0.26)), 0.6, shade)
    shade = np.where(inside & ((v > 0.83) | (u > 0.74)), 1.12, shade)
    image = wood(rng, shape, colour).astype(float) / 255.0
    return to_bytes(image * shade[..., None])


def framed(image: np.ndarray, colour: Colour, share: float, bars: Sequence[float] = ()) -> np.ndarray:
    """Paint a frame on a picture's edge, ``share`` of its rows wide, and vertical bars at fractions of its columns."""
    rows, columns = image.shape[:2]
    edge = max(round(share * rows), 2)
    whole = np.ones_like(image) * to_bytes(np.asarray(colour, float))
    shade = np.ones(image.shape[:2])
    shade[: edge // 2], shade[:, : edge // 2] = 0.8, 0.8
    whole = np.rint(whole * shade[..., None]).astype(np.uint8)
    whole[edge:-edge, edge:-edge] = image[edge:-edge, edge:-edge]
    for bar in bars:
        left = int(bar * columns - edge / 4)
        whole[:, left : left + max(edge // 2, 2)] = to_bytes(np.asarray(colour, float) * 0.9)
    return whole


def _window(
    rng: np.random.Generator, shape: Shape, reach_px: float
) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
    """Return a square around a random pixel, cut at the edges, and the distances down (r, 1) and across (1, c)."""
    row, column = (int(rng.random() * size) for size in shape)
    reach = int(np.ceil(reach_px)) + 1
    part = np.s_[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
    down = np.arange(shape[0])[part[0], None] - row
    across = np.arange(shape[1])[None, part[1]] - column
    return part, down, across


def _hue(turn: float, strength: float, value: float) -> np.ndarray:
    hue = turn % 1.0 * 6.0
    pure = np.array((abs(hue - 3.0) - 1.0, 2.0 - abs(hue - 2.0), 2.0 - abs(hue - 4.0)))
    return value * (1.0 - strength * (1.0 - np.clip(pure, 0.0, 1.0)))


def _steps(size: int, cells: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the index of the knot before each pixel, and the smooth weight of the next knot."""
    place = np.arange(size) * cells / size
    before = place.astype(int)
    t = place - before
    return before, t * t * (3 - 2 * t)


def _crack(rng: np.random.Generator, broken: np.ndarray) -> None:
    rows, columns = broken.shape
    place, heading = rng.random(2) * (rows, columns), rng.uniform(0, 2 * np.pi)
    for _ in range(int(rng.uniform(0.3, 0.8) * rows)):
        heading += rng.normal(0, 0.25)
        place += (np.sin(heading), np.cos(heading))
        r, c = int(place[0]), int(place[1])
        if not (0 <= r < rows and 0 <= c < columns):
            break
        broken[r : r + 2, c : c + 2] = True
