"""The static entities below ``world``: the room, its floor plan with metres along its sides, the colour scale.

In a study the plan changes: a function with the argument ``at``, places on timelines, logs what is valid from there on.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import trimesh
from matplotlib.colors import hsv_to_rgb, to_rgb

from deepgps.reports.plots import SCREEN, TICKS_M, colours_of
from deepgps.viewer.stream import Rows, put
from sim.errors import InputError
from sim.geometry import FreeSpace, limits

LAYER_M = 0.01  # height of one drawn layer above the next
SCALE_COLOURS = 65  # colours along a scale
ELLIPSE_POINTS = 37
MAX_METRES = 12  # Numbers along a side of the floor
LABEL_COLOUR = (128, 128, 128)  # Legible on labels of the dark and of the light theme
WALL_SHARE = 0.2  # Share of their height with which walls between rooms are drawn
STILL_BEHAVIOUR = rrb.EntityBehavior(interactive=False)
BACKDROP = ("room", "floor_plan", "metres", "scale")
"""Entities that cannot tell anything and so do not catch the pointer."""


def log_room(stream: rr.RecordingStream, scene: Path, space: FreeSpace, root: str = "world") -> None:
    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if scene.is_file():  # planar worlds have no walls
        room = rr.Asset3D(contents=open_room(scene, space), media_type="model/gltf-binary")
        stream.log(f"{root}/room", room, static=True)
    log_floor(stream, space, root=root)


def log_floor(stream: rr.RecordingStream, space: FreeSpace, at: Rows = (), root: str = "world") -> None:
    """Log the floor plan, and numbers of metres along two sides."""
    plan, corner = draw_floor_plan(space)
    put(
        stream,
        f"{root}/floor_plan",
        rr.GridMap(
            data=plan[::-1].tobytes(),  # Rerun wants the northern row first
            format=rr.components.ImageFormat(
                width=plan.shape[1], height=plan.shape[0], color_model="RGB", channel_datatype="U8"
            ),
            cell_size=space.cell_m,
            translation=[*corner, LAYER_M / 2],
        ),
        at,
    )
    (west, south), (east, north) = limits(space)
    step = max(1, round(max(east - west, north - south) / MAX_METRES))
    x, y = (np.arange(np.ceil(low / step) * step, high, step) for low, high in ((west, east), (south, north)))
    # labels are drawn below their points
    places = [*((one, north + 0.3, 0.0) for one in x), *((west - 0.2, one + 0.1, 0.0) for one in y)]
    numbers = [f"{one:g} m" for one in (*x, *y)]
    put(
        stream,
        f"{root}/metres",
        rr.Points3D(places, radii=0.0, colors=LABEL_COLOUR, labels=numbers, show_labels=True),
        at,
    )


def log_scale(
    stream: rr.RecordingStream, path: str, low: np.ndarray, high: np.ndarray, ticks_m: Sequence[float] = TICKS_M
) -> None:
    """Log the colour scale of lengths as a strip below a rectangle of the floor, from ``low`` to ``high`` (2,) [m]."""
    share = np.log(np.array(ticks_m) / ticks_m[0]) / np.log(ticks_m[-1] / ticks_m[0])
    colours = colours_of(np.geomspace(ticks_m[0], ticks_m[-1], SCALE_COLOURS), (ticks_m[0], ticks_m[-1]))
    labels = [f"{100 * ticks_m[0]:g} cm", *(f"{100 * tick:g}" for tick in ticks_m[1:-1]), f"{ticks_m[-1]:g} m"]
    log_strip(stream, path, low, high, colours, dict(zip(share, labels, strict=True)))


def log_strip(
    stream: rr.RecordingStream,
    path: str,
    low: np.ndarray,
    high: np.ndarray,
    colours: np.ndarray,
    labels: Mapping[float, str],
) -> None:
    """Log colours (``SCALE_COLOURS``, 4) as such a strip, with labels by their positions as shares of its length."""
    width = 0.9 * max(high[0] - low[0], 1.4 * (high[1] - low[1]))  # views are wider than a square room
    left, bottom = (low[0] + high[0] - width) / 2, low[1] - 0.35
    ends = np.stack([left + np.linspace(0, 1, SCALE_COLOURS) * width, np.full(SCALE_COLOURS, bottom)], axis=1)
    vertices = np.concatenate([lift(ends, 0.0), lift(ends + [0, 0.12], 0.0)])
    first = np.arange(SCALE_COLOURS - 1)[:, None]
    triangles = np.concatenate([first + [0, 1, SCALE_COLOURS + 1], first + [0, SCALE_COLOURS + 1, SCALE_COLOURS]])
    mesh = rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, vertex_colors=np.tile(colours, (2, 1)))
    stream.log(path, mesh, static=True)
    share = np.array(list(labels))
    points = lift(np.stack([left + share * width, np.full(len(share), bottom - 0.08)], axis=1), 0.0)
    ticks = rr.Points3D(points, radii=0.015, colors=LABEL_COLOUR, labels=list(labels.values()), show_labels=True)
    stream.log(f"{path}/ticks", ticks, static=True)


def lift(points: np.ndarray, z: float) -> np.ndarray:
    """Points (N, 2) as (N, 3) at height ``z`` [m]."""
    return np.concatenate([points, np.full((len(points), 1), z)], axis=1)


def draw_ellipses(centre: np.ndarray, covariance: np.ndarray, z: float) -> np.ndarray:
    """Ellipses of covariances (n, 2, 2) [m^2] around places (n, 2) [m], as lines (n, ELLIPSE_POINTS, 3) at height z."""
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    value, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(value.clip(0.0))[:, None, :]
    points = centre[:, None] + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ np.swapaxes(root, 1, 2)
    return lift(points.reshape(-1, 2), z).reshape(len(centre), ELLIPSE_POINTS, 3)


def draw_circles(centre: np.ndarray, radius: np.ndarray, z: float) -> np.ndarray:
    """Circles around places (n, 2) [m] with radii (n,) [m], as ``draw_ellipses`` draws ellipses."""
    return draw_ellipses(centre, radius[:, None, None] ** 2 * np.eye(2), z)


def open_room(scene: Path, space: FreeSpace) -> bytes:
    """The room's mesh as GLB, open to view: without its south wall and what is in its upper quarter, with low walls."""
    try:
        loaded = trimesh.load_scene(scene)
    except Exception as error:  # trimesh passes on whatever its readers raise
        raise InputError(f"{scene} cannot be read: {error}") from None
    roof, (begin, end) = 0.75 * loaded.bounds[1, 2], limits(space, margin_m=0.0)
    south = begin[1]
    hidden = []
    for node in loaded.graph.nodes_geometry:
        transform, name = loaded.graph[node]
        corners = trimesh.transform_points(trimesh.bounds.corners(loaded.geometry[name].bounds), transform)
        low, high = corners.min(axis=0), corners.max(axis=0)
        in_south_wall = high[1] < south and high[2] > 0.1
        on_south_wall = high[1] < south + 0.25 and low[2] > 0.05
        middle = (low + high)[:2] / 2
        between_rooms = high[2] > 1.2 * roof and (begin < middle).all() and (middle < end).all()
        if low[2] > roof or in_south_wall or on_south_wall or (between_rooms and low[2] > 0.1):  # lintels, too
            hidden.append(name)
        elif between_rooms:
            loaded.graph.update(node, matrix=np.diag([1.0, 1.0, WALL_SHARE, 1.0]) @ transform)
    loaded.delete_geometry(hidden)
    glb = loaded.export(file_type="glb")
    assert isinstance(glb, bytes)
    return glb


def draw_floor_plan(space: FreeSpace) -> tuple[np.ndarray, np.ndarray]:
    """Picture of the floor (rows, columns, 3) uint8, southern row first, and its south-west corner (2,) [m]."""
    palette = [to_rgb(colour) for colour in SCREEN]
    kind = np.where(space.reachable, 0, np.where(space.free, 1, 2))
    cells = (np.stack(limits(space, margin_m=0.1)) - space.origin) / space.cell_m
    low, high = np.maximum(np.rint(cells[0]).astype(int), 0), np.rint(cells[1]).astype(int) + 1
    picture = (np.array(palette) * 255).astype(np.uint8)[kind[low[1] : high[1], low[0] : high[0]]]
    return np.ascontiguousarray(picture), space.origin + (low - 0.5) * space.cell_m


def colours_of_places(place: np.ndarray) -> np.ndarray:
    """Colours (N, 3) uint8 that tell places (N, 2) [m] apart: hue around the middle, paler towards it."""
    middle = (place.min(axis=0) + place.max(axis=0)) / 2
    offset = (place - middle) / np.maximum(np.ptp(place, axis=0) / 2, 1e-9)
    hue = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1
    saturation = np.clip(0.15 + 0.85 * np.linalg.norm(offset, axis=1), 0, 1)
    return (hsv_to_rgb(np.stack([hue, saturation, np.ones(len(place))], axis=1)) * 255).astype(np.uint8)
