"""What stands still below ``world``: the room, its floor plan, the colour scale, the error fields."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
from scipy.spatial import KDTree

from deepgps import figures, playback
from deepgps.figures import WorstField, colours_of
from sim.records import FreeSpace

LAYER_M = 0.01  # height of one drawn layer above the next
LARGEST_M = 0.08
STRIP = 65  # colours along a scale


def log_room(stream: rr.RecordingStream, scene: Path, space: FreeSpace, root: str = "world") -> None:
    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if scene.is_file():  # a plane world has no walls to see
        room = rr.Asset3D(contents=playback.open_room(scene, space), media_type="model/gltf-binary")
        stream.log(f"{root}/room", room, static=True)
    plan, corner = playback.draw_floor_plan(space)
    stream.log(
        f"{root}/floor_plan",
        rr.GridMap(
            data=plan[::-1].tobytes(),  # Rerun wants the northern row first
            format=rr.components.ImageFormat(
                width=plan.shape[1], height=plan.shape[0], color_model="RGB", channel_datatype="U8"
            ),
            cell_size=space.cell_m,
            translation=[*corner, LAYER_M / 2],
        ),
        static=True,
    )
    strips = [lift(line, 0.0) for line in playback.find_outline(space)]
    stream.log(f"{root}/outline", rr.LineStrips3D(strips, radii=0.008, colors=[120, 130, 150]), static=True)


def log_scale(stream: rr.RecordingStream, space: FreeSpace, root: str = "world") -> None:
    """The colour scale of errors as a strip on the floor before the room."""
    low, high = figures.SCALE_M
    decades = np.log(high / low)
    ticks = np.array(figures.TICKS_M)
    labels = [f"{100 * tick:g} cm" if tick < 1 else f"{tick:g} m" for tick in ticks]
    colours = colours_of(low * np.exp(np.linspace(0, 1, STRIP) * decades))
    log_strip(stream, space, colours, np.log(ticks / low) / decades, labels, root)


def log_strip(
    stream: rr.RecordingStream,
    space: FreeSpace,
    colours: np.ndarray,
    share: np.ndarray,
    labels: Sequence[str],
    root: str = "world",
) -> None:
    """A strip of colours (``STRIP``, 4) on the floor before the room, with labels at shares (n,) of its length."""
    low, high = figures.limits(space)
    width = 0.9 * max(high[0] - low[0], 1.4 * (high[1] - low[1]))  # views are wider than a square room
    left, bottom = (low[0] + high[0] - width) / 2, low[1] - 0.35
    ends = np.stack([left + np.linspace(0, 1, STRIP) * width, np.full(STRIP, bottom)], axis=1)
    vertices = np.concatenate([lift(ends, 0.0), lift(ends + [0, 0.12], 0.0)])
    first = np.arange(STRIP - 1)
    triangles = np.concatenate(
        [
            np.stack([first, first + 1, first + STRIP + 1], axis=1),
            np.stack([first, first + STRIP + 1, first + STRIP], axis=1),
        ]
    )
    mesh = rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, vertex_colors=np.tile(colours, (2, 1)))
    stream.log(f"{root}/scale", mesh, static=True)
    points = lift(np.stack([left + share * width, np.full(len(share), bottom - 0.08)], axis=1), 0.0)
    at = colours[np.rint(share * (STRIP - 1)).astype(int)]
    stream.log(
        f"{root}/scale/ticks", rr.Points3D(points, radii=0.015, colors=at, labels=labels, show_labels=True), static=True
    )


def log_field(stream: rr.RecordingStream, name: str, field: WorstField, root: str = "world") -> None:
    """Arrows from truth to prediction, and a dot at each truth, coloured by magnitude."""
    path, colours = f"{root}/error_field/{name}", colours_of(field.error)
    size = find_spacing(field.truth)
    arrows = rr.Arrows3D(
        origins=lift(field.truth, LAYER_M),
        vectors=lift(field.predicted - field.truth, 0.0),
        colors=colours,
        radii=0.09 * size,
    )
    stream.log(path, arrows, static=True)
    dots = rr.Points3D(lift(field.truth, LAYER_M), radii=0.22 * size, colors=colours, point_shading="Flat")
    stream.log(f"{path}/places", dots, static=True)


def find_spacing(places: np.ndarray) -> float:
    """Median distance [m] of places (C, 2) [m] from the next one, at most 8 cm: so large may be what stands at each."""
    if len(places) < 2:
        return LARGEST_M
    distance, _ = KDTree(places).query(places, k=2)
    return min(float(np.median(distance[:, 1])), LARGEST_M)


def lift(points: np.ndarray, z: float) -> np.ndarray:
    """Points (N, 2) as (N, 3) at height ``z`` [m]."""
    return np.concatenate([points, np.full((len(points), 1), z)], axis=1)
