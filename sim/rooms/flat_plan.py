"""The plan of a flat: a hall, rooms that grow beside it as rectangles and then as L shapes, and the doorways."""

from dataclasses import dataclass

import numpy as np

CELL_M = 0.3  # Side of the cells in which rooms grow [m]
HALL_CELLS, SOWN_CELLS, ARM_CELLS, MIN_CELLS = 5, 4, 4, 8
"""Width of the hall, side of a room before it grows, least width of an arm of an L, least side of a living space."""
DRAWS = 60  # Plans that are drawn; the one with the best proportions is taken
AREA_M2 = {"living_room": 24.0, "kitchen": 13.0, "bedroom": 15.0, "bathroom": 7.0, "office": 12.0, "workshop": 12.0}
"""Usual area of each kind of room, to which the areas of a flat are in proportion."""
NEEDED, EXTRA = ("bathroom", "living_room", "kitchen", "bedroom"), ("bedroom", "office", "bathroom", "workshop")
MAX_ROOMS, ROOM_M2 = 7, 15.5  # Most rooms beside the hall, and the area of a flat for each of them
DOOR_M, DOOR_GAP_M = (0.75, 0.9), 0.2  # Widths of doors, and their least distance from a corner
HALL = 0
Border = tuple[int, int, int, int]
"""Longest straight border of two rooms: its length, its axis (0: along x), its line and where it begins [cells]."""


@dataclass(frozen=True)
class Doorway:
    """A doorway in a wall between two rooms."""

    rooms: tuple[int, int]  # Numbers of the rooms; the door opens into the second
    middle: np.ndarray  # Middle (2,) [m]
    width_m: float  # Width [m]


@dataclass(frozen=True)
class FlatPlan:
    """Rooms, of which the first is the hall, and their doorways."""

    kinds: tuple[str, ...]  # Kind of each room
    corners: list[np.ndarray]  # Corners (V, 2) of each room, in the middle of its walls, counter-clockwise [m]
    doorways: list[Doorway]


def draw_size(rng: np.random.Generator) -> tuple[float, float]:
    """Draw the width and depth of a flat of 60 to 120 m2 [m]."""
    area, aspect = rng.uniform(64.0, 116.0), rng.uniform(1.0, 1.7)
    width, depth = (float(round((area * ratio) ** 0.5 / CELL_M) * CELL_M) for ratio in (aspect, 1 / aspect))
    return width, depth


def draw_plan(rng: np.random.Generator, low: np.ndarray, size_m: np.ndarray) -> FlatPlan | None:
    """Draw plans of a rectangle from its lower corner (2,) and size (2,) [m]; return the best by proportion, if any."""
    columns, rows = np.rint(size_m / CELL_M).astype(int).tolist()
    count = int(np.clip(round(float(np.prod(size_m)) / ROOM_M2 + rng.uniform(-0.7, 0.7)), len(NEEDED), MAX_ROOMS))
    extra = sorted(rng.permutation(len(EXTRA))[: count - len(NEEDED)].tolist())
    kinds = ("hall", *NEEDED, *(EXTRA[number] for number in extra))
    drawn = [_grow(rng, (min(rows, columns), max(rows, columns)), kinds) for _ in range(DRAWS)]
    drawn = [label.T for label in drawn] if rows > columns else drawn
    scale = size_m / (columns, rows)
    for label in sorted(drawn, key=lambda label: _judge(label, kinds)):
        outlines = [_trace(label == number) for number in range(len(kinds))]
        pairs = _connect(label, kinds)
        if pairs is not None and all(map(len, outlines)):
            doorways = [_place(rng, pair, _border(label, *pair), low, scale) for pair in pairs]
            return FlatPlan(kinds, [low + scale * outline for outline in outlines], doorways)
    return None


def _grow(rng: np.random.Generator, shape: tuple[int, int], kinds: tuple[str, ...]) -> np.ndarray:
    """Label the cells (rows, columns) with the numbers of their rooms, -1 where no room is."""
    label = np.full(shape, -1)
    first = int(rng.integers(shape[0] - HALL_CELLS + 1))
    label[first : first + HALL_CELLS, : int(shape[1] * rng.uniform(0.5, 0.9))] = HALL
    wanted = _share(kinds) * (label < 0).sum()
    rooms = range(1, len(kinds))
    for number in rooms:
        _sow(rng, label, number)
    for limit in (wanted, np.full(len(kinds), np.inf)):
        growing = [number for number in rooms if (label == number).any()]
        while growing:
            number = min(growing, key=lambda number: (label == number).sum() / wanted[number])
            free = [part for part in _sides(label, number) if len(part) and (part[0] < 0).all()]
            if not free or (label == number).sum() >= limit[number]:
                growing.remove(number)
            else:
                free[rng.integers(len(free))][0] = number
    for number in rng.permutation(rooms).tolist():
        _add_arm(rng, label, number)
    # the larger a room has become, the larger the kind that it is
    found = np.argsort([(label == number).sum() for number in rooms], kind="stable")
    numbers = np.full(len(kinds) + 1, -1)
    numbers[HALL] = HALL
    numbers[1 + found] = 1 + np.argsort(wanted[1:], kind="stable")
    return numbers[label]


def _share(kinds: tuple[str, ...]) -> np.ndarray:
    """Part of the area of all rooms but the hall that each should have."""
    area = np.array([AREA_M2.get(kind, 0.0) for kind in kinds])
    return area / area.sum()


def _sow(rng: np.random.Generator, label: np.ndarray, number: int) -> None:
    """Label one of the free squares beside the hall, if there is one."""
    rows, columns = np.nonzero(label == HALL)
    first, end = rows.min(), columns.max() + 1
    places = [(row, column) for row in (first - SOWN_CELLS, first + HALL_CELLS) for column in range(end - SOWN_CELLS)]
    places += [(first, end), (first + 1, end)]
    squares = [label[row : row + SOWN_CELLS, column : column + SOWN_CELLS] for row, column in places if row >= 0]
    free = [square for square in squares if square.size == SOWN_CELLS**2 and (square < 0).all()]
    if free:
        free[rng.integers(len(free))][:] = number


def _sides(label: np.ndarray, number: int) -> list[np.ndarray]:
    """Views of the cells (away, along) beyond each of the four sides of a room, the nearest first."""
    rows, columns = np.nonzero(label == number)
    if not len(rows):
        return []
    along, across = np.s_[columns.min() : columns.max() + 1], np.s_[rows.min() : rows.max() + 1]
    left, right = label[across, : along.start].T[::-1], label[across, along.stop :].T
    return [label[: across.start, along][::-1], label[across.stop :, along], left, right]


def _add_arm(rng: np.random.Generator, label: np.ndarray, number: int) -> None:
    """Make a rectangle an L: it takes free cells beyond a part of one side, from an end of the side."""
    sides = _sides(label, number)
    for side in rng.permutation(len(sides)).tolist():
        for part in (sides[side], sides[side][:, ::-1]):
            width = int(np.argmin([*(part[0] < 0), False])) if len(part) else 0
            if width >= ARM_CELLS:
                deep = int(np.argmin([*(part[:, :width] < 0).all(axis=1), False]))
                part[:deep, :width] = number
                return


def _connect(label: np.ndarray, kinds: tuple[str, ...]) -> list[tuple[int, int]] | None:
    """Pairs of rooms with a door: the hall and each room beside it, other rooms and a neighbour, kitchen and living
    room; None if a bathroom is not beside the hall or a room is beside none with room for a door."""
    least = int(np.ceil((DOOR_M[1] + 2 * DOOR_GAP_M) / CELL_M))
    pairs, reached = [], [HALL]
    living = sorted(range(1, len(kinds)), key=lambda number: kinds[number] == "bathroom")
    for number in living:
        doors = [other for other in reached if _border(label, other, number)[0] >= least]
        if not doors or (kinds[number] == "bathroom" and HALL not in doors):
            return None
        pairs.append((doors[0], number))
        reached += [number] * (kinds[number] != "bathroom")
    both = kinds.index("living_room"), kinds.index("kitchen")
    return pairs + [both] * (both not in pairs and _border(label, *both)[0] >= least)


def _judge(label: np.ndarray, kinds: tuple[str, ...]) -> float:
    """Cost of a plan: floor in no room, long and narrow rooms, arms, and areas that are not in proportion."""
    wanted = _share(kinds) * (label != HALL).sum()
    cost = 20.0 * float((label < 0).mean())
    for number in range(1, len(kinds)):
        rows, columns = np.nonzero(label == number)
        if not len(rows):
            return np.inf
        short, long = sorted((np.ptp(rows) + 1, np.ptp(columns) + 1))
        least = SOWN_CELLS + 1 if kinds[number] == "bathroom" else MIN_CELLS
        cost += max(long / short - 1.5, 0.0) + 2.0 * max(least - short, 0) + 1.5 * (1.0 - len(rows) / (short * long))
        cost += abs(float(np.log(len(rows) / wanted[number])))
    return cost


def _border(label: np.ndarray, one: int, other: int) -> Border:
    best = (0, 0, 0, 0)
    for axis, cells in enumerate((label, label.T)):
        before, after = cells[:-1], cells[1:]
        beside = ((before == one) & (after == other)) | ((before == other) & (after == one))
        for line in np.flatnonzero(beside.any(axis=1)).tolist():
            runs = np.flatnonzero(np.diff([0, *beside[line], 0])).reshape(-1, 2).tolist()
            best = max(best, *((last - first, axis, line + 1, first) for first, last in runs))
    return best


def _place(
    rng: np.random.Generator, rooms: tuple[int, int], border: Border, low: np.ndarray, scale: np.ndarray
) -> Doorway:
    """Place a doorway of random width on a border; ``scale`` (2,) are the sides of a cell [m]."""
    length, axis, line, first = border
    width = float(rng.uniform(*DOOR_M))
    gap = (DOOR_GAP_M + width / 2) / scale[axis]
    place = (first + rng.uniform(gap, length - gap), line)
    return Doorway(rooms, low + scale * (place if axis == 0 else place[::-1]), width)


def _trace(mask: np.ndarray) -> np.ndarray:
    """Corners (V, 2) x, y of the outline of cells, counter-clockwise [cells]; none if it is not a single loop."""
    follows = {}
    for row, column in np.argwhere(mask).tolist():
        corners = [(column, row), (column + 1, row), (column + 1, row + 1), (column, row + 1)]
        beyond = [(row - 1, column), (row, column + 1), (row + 1, column), (row, column - 1)]
        for number, (r, c) in enumerate(beyond):
            if not (0 <= r < mask.shape[0] and 0 <= c < mask.shape[1] and mask[r, c]):
                follows.setdefault(corners[number], []).append(corners[(number + 1) % 4])
    if not follows or any(len(ends) > 1 for ends in follows.values()):
        return np.zeros((0, 2))
    loop = [min(follows)]
    while len(loop) == 1 or loop[-1] != loop[0]:
        loop += follows[loop[-1]]
    points = np.array(loop[:-1])
    if len(points) < len(follows):
        return np.zeros((0, 2))
    straight = (np.roll(points, 1, axis=0) + np.roll(points, -1, axis=0) == 2 * points).all(axis=1)
    return points[~straight]
