"""Showing poses of images as they come: the robot in the room, the way it came, its circle of 95 %, the image."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from deepgps.viewer.connect import LOST_VIEWER_ERRORS, connect
from deepgps.viewer.layout import aim_eye, arrange, follow, room_view
from deepgps.viewer.scene import LAYER_M, draw_circles, lift, log_room
from sim.errors import one_line
from sim.geometry import limits
from sim.recording.format import has_truth, open_truth

APPLICATION = "deepgps locate"
IMAGE, TIME = "image", "time"  # Timelines: the number of the image, and when it was taken, if that is known
TRAIL_POSITIONS = 2000  # Positions of which the way is drawn
ROBOT_COLOUR, REFUSED_COLOUR, TRAIL_COLOUR = (90, 200, 250), (240, 90, 80), (150, 160, 180)
ARROW_M = 0.25
FLUSH_S = 5.0  # How long a viewer may take for what is left at the end [s]

Show = Callable[[float | None, np.ndarray, np.ndarray, float | None, float | None, bool | None], None]
"""(time [s], polar image, position (2,) [m], yaw [rad], radius of 95 % [m], whether it is accepted) of an image."""


@contextmanager
def show_located(address: str, recording: Path, in_world: bool, warn: Callable[[str], None]) -> Iterator[Show]:
    """Show poses in a viewer, in the recording's room if they are in the world's frame; if it is lost, work continues.

    The address, ``warn`` and what is raised are as in ``show_live``.
    """
    stream = connect(address, APPLICATION)
    try:
        yield LocatedView(stream, recording if in_world and has_truth(recording) else None).show
    finally:
        try:
            stream.flush(timeout_sec=FLUSH_S)
        except LOST_VIEWER_ERRORS as error:
            warn(f"the connection to the viewer is lost ({one_line(error)})")
        stream.disconnect()


class LocatedView:
    """What the viewer shows, in the room of a recording if poses have a place in it."""

    def __init__(self, stream: rr.RecordingStream, recording: Path | None) -> None:
        self.stream, self.number, self.trail = stream, 0, deque[np.ndarray](maxlen=TRAIL_POSITIONS)
        space = None if recording is None else open_truth(recording).free_space
        if recording is not None and space is not None:
            log_room(stream, recording / "scene.glb", space)
        room = room_view(
            "Robot, with the circle of 95 %",
            ["room", "floor_plan", "located/**"],
            aim_eye(space and limits(space), tilt=0.45, reach=1.3, before=-0.4),
            line_grid=space is None,
        )
        beside = rrb.Vertical(
            rrb.Spatial2DView(name="Polar image", origin="image"),
            rrb.TimeSeriesView(name="Radius of 95 % [m]", origin="radius"),
        )
        tab = rrb.Horizontal(room, beside, column_shares=[5, 2], name="Located")
        stream.send_blueprint(arrange([tab], follow(IMAGE)))

    def show(
        self,
        time_s: float | None,
        polar: np.ndarray,
        position: np.ndarray,
        yaw: float | None,
        radius_m: float | None,
        accepted: bool | None,
    ) -> None:
        """Show one image and its pose; see ``Show``."""
        self.stream.set_time(IMAGE, sequence=self.number)
        if time_s is not None:
            self.stream.set_time(TIME, timestamp=time_s)
        self.number += 1
        refused, position = accepted is not None and not accepted, np.asarray(position, float)
        if not refused and np.isfinite(position).all():
            self.trail.append(position)
        at, colour = lift(position[None], 2 * LAYER_M), REFUSED_COLOUR if refused else ROBOT_COLOUR
        arrow = [] if yaw is None or np.isnan(yaw) else [[ARROW_M * np.cos(yaw), ARROW_M * np.sin(yaw), 0.0]]
        circle = draw_circles(position[None], np.array([radius_m or 0.0]), LAYER_M)
        way = lift(np.array(self.trail).reshape(-1, 2), LAYER_M)
        things = {
            "image": rr.Image(polar).compress(jpeg_quality=85),
            "world/located/position": rr.Points3D(at, radii=0.05, colors=[colour]),
            "world/located/yaw": rr.Arrows3D(vectors=arrow, origins=at[: len(arrow)], radii=0.02, colors=[colour]),
            "world/located/radius": rr.LineStrips3D(circle, colors=[colour], radii=0.006),
            "world/located/way": rr.LineStrips3D([way], colors=[TRAIL_COLOUR], radii=0.008),
            "radius": None if radius_m is None else rr.Scalars(radius_m),
        }
        for path, thing in things.items():
            if thing is not None:
                self.stream.log(path, thing)
