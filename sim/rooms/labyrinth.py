"""What makes a room a labyrinth: cells of 1 m, and walls between them that repeat a few textures."""

import numpy as np

from sim.rooms.furniture import textures
from sim.rooms.furniture.primitives import box
from sim.rooms.placement import Finish, Room, surface

CELL_M, WALL_M = 1.0, 0.08  # Nominal side of a cell, and thickness of the walls [m]
COLUMNS, ROWS = (7, 11), (5, 9)  # Fewest and most cells along x and y of a labyrinth without a size of its own
TEXTURES = (2, 4)
LOOPS = (0.15, 0.3)  # Range of the share of walls that are taken out, so that there are ways round
FINISHES: tuple[Finish, ...] = ("brick", "wallpaper", "boards", "tile", "plaster")
Cell = tuple[int, int]


def draw_size(rng: np.random.Generator) -> tuple[float, float]:
    """Draw the width and depth of a labyrinth [m]."""
    columns, rows = (int(rng.integers(low, high + 1)) for low, high in (COLUMNS, ROWS))
    return columns * CELL_M, rows * CELL_M


def raise_labyrinth(room: Room) -> None:
    """Put posts, and walls between them, into an empty room and before its own walls; few textures repeat on them."""
    rng = room.rng
    low, high = room.layout.corners.min(axis=0), room.layout.corners.max(axis=0)
    columns, rows = np.maximum(np.rint((high - low) / CELL_M).astype(int), 2).tolist()
    side = (high - low) / (columns, rows)
    passages = draw_passages(columns, rows, rng, float(rng.uniform(*LOOPS)))
    kinds = 1 if room.twins is not None else int(rng.integers(TEXTURES[0], TEXTURES[1] + 1))
    finishes, hue = rng.permutation(len(FINISHES))[:kinds], float(rng.random())
    materials = [
        surface(room.look, rng, FINISHES[finish], (CELL_M, room.height_m), textures.muted(rng, hue + 0.382 * number))
        for number, finish in enumerate(finishes)
    ]
    posts = set()
    for x, y in np.ndindex(columns + 1, rows + 1):
        for along, cells in ((0, ((x, y - 1), (x, y))), (1, ((x - 1, y), (x, y)))):  # a wall begins at (x, y)
            end = (x + (along == 0), y + (along == 1))
            if end[0] > columns or end[1] > rows or frozenset(cells) in passages:
                continue
            posts |= {(x, y), end}
            size = (side[0] - WALL_M, WALL_M) if along == 0 else (WALL_M, side[1] - WALL_M)
            _raise(room, low + side * np.add((x, y), end) / 2, size, materials[rng.integers(kinds)])
    for post in sorted(posts):
        _raise(room, low + side * post, (WALL_M, WALL_M), room.look.white)


def draw_passages(columns: int, rows: int, rng: np.random.Generator, loops: float) -> set[frozenset[Cell]]:
    """Draw which neighbouring cells are connected: a random spanning tree by depth-first search, and some loops.

    ``loops`` is the share of all pairs of neighbours that are connected whether or not the tree has them.
    """
    cells = [(x, y) for x in range(columns) for y in range(rows)]
    path, seen = [cells[0]], {cells[0]}
    passages = set()
    while path:
        fresh = [cell for cell in _neighbours(path[-1], columns, rows) if cell not in seen]
        if not fresh:
            path.pop()
            continue
        chosen = fresh[rng.integers(len(fresh))]
        passages.add(frozenset((path[-1], chosen)))
        seen.add(chosen)
        path.append(chosen)
    for cell in cells:
        for other in _neighbours(cell, columns, rows):
            if other > cell and rng.random() < loops:
                passages.add(frozenset((cell, other)))
    return passages


def _neighbours(cell: Cell, columns: int, rows: int) -> list[Cell]:
    x, y = cell
    places = ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1))
    return [place for place in places if 0 <= place[0] < columns and 0 <= place[1] < rows]


def _raise(room: Room, middle: np.ndarray, size: tuple[float, float], material: str) -> None:
    x, y = middle.tolist()
    body = room.spec.worldbody.add_body(name=room.name("partition"), pos=(x, y, 0.0))
    box(body, (0.0, 0.0, room.height_m / 2), (*size, room.height_m), material, solid=True)
