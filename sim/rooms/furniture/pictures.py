"""Procedural pictures: paintings, the view from a window, a screen, rows of books, leaves; (rows, columns, 3) uint8."""

import itertools

import numpy as np

from sim.rooms.furniture.textures import Shape, clouds, noise, to_bytes, vivid


def painting(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A painting in one of four styles: landscape, blocks of colour, discs, waves."""
    manner = (_landscape, _blocks, _discs, _waves)[rng.integers(4)]
    return to_bytes(manner(rng, shape) * (0.9 + 0.2 * noise(rng, shape, (shape[0] / 3, shape[1] / 3)))[..., None])


def window_view(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A bright sky with clouds over hills, with a few houses and trees."""
    rows, columns = shape
    down = np.linspace(0, 1, rows)[:, None, None]
    sky = np.array((0.45, 0.68, 0.98)) * (1 - down) + np.array((0.95, 0.92, 0.85)) * down
    cloud = np.clip((clouds(rng, shape, (3, 4), 4) - 0.48) * 5, 0, 1)[..., None]
    image = sky * (1 - cloud) + 0.98 * cloud
    for depth in range(2):
        ridge = (0.55 + 0.15 * depth + 0.2 * (noise(rng, (1, columns), (1, 3)) - 0.5))[0] * rows
        below = (np.arange(rows)[:, None] > ridge[None, :])[..., None]
        green = np.array((0.3, 0.5, 0.28)) * rng.uniform(0.7, 1.2)
        image = np.where(below, green * (0.8 + 0.4 * clouds(rng, shape, (6, 6), 2))[..., None], image)
    for _ in range(rng.integers(1, 4)):
        _house(rng, image)
    for _ in range(rng.integers(1, 4)):
        _blot(rng, image, (0.55, 0.85), 0.1, np.array((0.12, 0.33, 0.12)))
    return to_bytes(image)


def screen(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A lit screen: a picture, or windows with lines of text."""
    if rng.random() < 0.5:
        return to_bytes(_landscape(rng, shape) * 0.9)
    rows, columns = shape
    image = np.ones((rows, columns, 3)) * vivid(rng) * 0.5
    for _ in range(3):
        top, left = int(rng.uniform(0, 0.5) * rows), int(rng.uniform(0, 0.6) * columns)
        bottom, right = top + rows // 3, left + columns // 3
        image[top:bottom, left:right] = 0.92
        image[top : top + rows // 24 + 1, left:right] = vivid(rng)
        for line in range(top + rows // 12, bottom - 2, max(rows // 20, 2)):
            image[line, left + 3 : left + 3 + int(rng.uniform(0.3, 0.9) * columns / 3)] = 0.35
    return to_bytes(image)


def books(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A row of book spines of uneven width and height, with titles, and now and then a gap."""
    rows, columns = shape
    image = np.ones((rows, columns, 3)) * 0.1
    left = 0
    while left < columns:
        width = int(rng.uniform(0.03, 0.075) * columns) + 2
        if rng.random() < 0.08:
            left += width
            continue
        top = int(rng.uniform(0.02, 0.35) * rows)
        right = min(left + width, columns)
        colour = vivid(rng) if rng.random() < 0.8 else np.ones(3) * rng.uniform(0.2, 0.9)
        round_back = 0.75 + 0.3 * np.sin(np.pi * (np.arange(right - left) + 0.5) / width)
        image[top:, left:right] = (round_back[:, None] * colour)[None]
        band = top + int(rng.uniform(0.1, 0.5) * (rows - top))
        image[band : band + rows // 10, left:right] = 1.0 - colour * rng.uniform(0.3, 0.8)
        left = right
    board = max(rows // 12, 2)
    image[-board:] = np.array((0.5, 0.34, 0.2)) * rng.uniform(0.6, 1.2)
    return to_bytes(image)


def leaves(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """Foliage: light and dark leaves."""
    green = np.array((0.2, 0.5, 0.18)) * rng.uniform(0.8, 1.2, 3)
    shade = 0.35 + 1.2 * clouds(rng, shape, (9, 14), 3) ** 1.5
    return to_bytes(shade[..., None] * green)


def pegboard(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A tool wall: dark outlines of saws, hammers, spanners and screwdrivers on a pale board."""
    rows, columns = shape
    image = np.ones((rows, columns, 3)) * (0.8, 0.7, 0.5)
    image[(np.arange(rows) % 8 < 2)[:, None] & (np.arange(columns) % 8 < 2)[None, :]] *= 0.7
    down, across = np.mgrid[0:rows, 0:columns] / rows
    count = max(int(columns / rows * 5), 3)
    for place in np.linspace(0.08, columns / rows - 0.12, count):
        top, length = rng.uniform(0.06, 0.3), rng.uniform(0.3, 0.55)
        handle = (np.abs(across - place) < 0.018) & (down > top) & (down < top + length)
        image[handle] = vivid(rng) * 0.9
        head = (np.abs(across - place) < rng.uniform(0.03, 0.075)) & (np.abs(down - top) < rng.uniform(0.03, 0.09))
        image[head] = 0.25 + 0.1 * rng.random()
    return to_bytes(image)


def sheet(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A whiteboard or notice board: boxes, arrows and lines of writing on white."""
    rows, columns = shape
    image = np.ones((rows, columns, 3)) * (0.95, 0.96, 0.97)
    for _ in range(12):
        top, left = int(rng.uniform(0.05, 0.8) * rows), int(rng.uniform(0.03, 0.8) * columns)
        wide, ink = int(rng.uniform(0.08, 0.25) * columns), vivid(rng) * 0.8
        if rng.random() < 0.4:
            tall = int(rng.uniform(0.1, 0.2) * rows)
            image[top : top + tall, left : left + wide] = ink
            image[top + 2 : top + tall - 2, left + 2 : left + wide - 2] = 0.9 + 0.1 * ink
        else:
            image[top : top + 2, left : left + wide] = ink
    return to_bytes(image)


def clock_face(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    """A round dial with twelve marks and two hands, on a dark square."""
    rows, columns = shape
    v, u = np.mgrid[0:rows, 0:columns] / rows * 2.0 - 1.0
    radius, turn = np.hypot(u, v), np.arctan2(u, -v)
    image = np.where((radius < 0.95)[..., None], 0.95, 0.15) * np.ones(3)
    image[(radius > 0.75) & (radius < 0.88) & (np.abs((turn * 6 / np.pi + 0.5) % 1.0 - 0.5) < 0.12)] = 0.1
    for length, width in ((0.45, 0.09), (0.7, 0.06)):
        hand = rng.uniform(0, 2 * np.pi)
        along, aside = u * np.sin(hand) - v * np.cos(hand), u * np.cos(hand) + v * np.sin(hand)
        image[(along > 0) & (along < length) & (np.abs(aside) < width)] = 0.08
    return to_bytes(image)


def _landscape(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    rows, columns = shape
    image = np.ones((rows, columns, 3)) * vivid(rng)
    image = image * (1.2 - 0.5 * np.linspace(0, 1, rows))[:, None, None]
    _blot(rng, image, (0.15, 0.3), 0.1, np.array((1.0, 0.92, 0.6)))
    for height in np.sort(rng.uniform(0.35, 0.9, 4)):
        ridge = (height + 0.3 * (noise(rng, (1, columns), (1, 4))[0] - 0.5)) * rows
        image = np.where((np.arange(rows)[:, None] > ridge)[..., None], vivid(rng), image)
    return image


def _blocks(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    rows, columns = shape
    image = np.ones((rows, columns, 3)) * 0.93
    down = np.concatenate([[0], np.sort(rng.uniform(0.1, 0.9, 3)), [1]]) * rows
    across = np.concatenate([[0], np.sort(rng.uniform(0.1, 0.9, 3)), [1]]) * columns
    for top, bottom in itertools.pairwise(down):
        for left, right in itertools.pairwise(across):
            if rng.random() < 0.65:
                image[int(top) + 2 : int(bottom), int(left) + 2 : int(right)] = vivid(rng)
    return image


def _discs(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    image = np.ones((*shape, 3)) * vivid(rng)
    for _ in range(7):
        _blot(rng, image, (0.1, 0.9), rng.uniform(0.08, 0.3), vivid(rng))
    return image


def _waves(rng: np.random.Generator, shape: Shape) -> np.ndarray:
    bands = (clouds(rng, shape, (2, 2), 2) * rng.uniform(10, 20)).astype(int) % 5
    return np.stack([vivid(rng) for _ in range(5)])[bands]


def _blot(
    rng: np.random.Generator, image: np.ndarray, height: tuple[float, float], size: float, colour: np.ndarray
) -> None:
    rows, columns = image.shape[:2]
    middle = rng.uniform(*height) * rows, rng.random() * columns
    down, across = np.mgrid[0:rows, 0:columns]
    image[np.hypot(down - middle[0], across - middle[1]) < size * rows] = colour


def _house(rng: np.random.Generator, image: np.ndarray) -> None:
    rows, columns = image.shape[:2]
    left, wide = int(rng.uniform(0, 0.8) * columns), int(rng.uniform(0.1, 0.22) * columns)
    top = int(rng.uniform(0.45, 0.6) * rows)
    bottom, roof = top + int(0.25 * rows), int(0.1 * rows)
    image[top:bottom, left : left + wide] = rng.uniform(0.6, 0.95, 3)
    for row in range(roof):
        inset = (roof - row) * wide // (2 * max(roof, 1))
        image[top - roof + row, left + inset : left + wide - inset] = (0.6, 0.25, 0.18)
    image[top + roof // 2 : top + roof, left + wide // 4 : left + wide // 2] = (0.2, 0.25, 0.35)
