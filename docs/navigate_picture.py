"""Draw README's animation of drives to goals, from a run that has driven to some.

``.venv/bin/deepgps run flat --drive.headings map --methods registration --out runs/flat``, then ``.venv/bin/deepgps
navigate runs/flat --goals 6 --methods registration`` and ``.venv/bin/python -m docs.navigate_picture runs/flat``.
"""

import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

from deepgps.config.methods import folder_of
from deepgps.evaluation.stored_alignment import read_alignment
from deepgps.viewer.drive import camera_of
from deepgps.viewer.pictures import ROUND_PX, make_warp, warp_round
from sim.alignment import Alignment
from sim.files.atomic import write_bytes
from sim.files.checksums import read_arrays
from sim.recording.format import Recording, open_recording, open_truth

METHOD, GOALS, STEPS = "registration", 5, 5  # The drives that are shown, and rows of the log for a picture
FRAME_MS, END_MS = 90, 900  # How long a picture lasts, and the last one of a drive [ms]


def draw_frames(
    log: dict[str, np.ndarray], world: Alignment, recording: Recording
) -> Iterator[tuple[Image.Image, int]]:
    """Pictures of the drives with how long each lasts [ms]: plan, route, goal, own and true position, image."""
    camera, space, figure = (
        camera_of(recording),
        open_truth(recording.folder).free_space,
        Figure(figsize=(8.6, 4.0), dpi=80),
    )
    plan, seen = figure.subplots(1, 2, width_ratios=(2.6, 1.0))
    figure.subplots_adjust(0.01, 0.01, 0.99, 0.93, wspace=0.03)
    floor, warp = space.places(), make_warp(camera, camera.rings, camera.sectors, ROUND_PX)
    size = np.array(space.reachable.shape[::-1]) * space.cell_m
    extent = (space.origin[0], space.origin[0] + size[0], space.origin[1], space.origin[1] + size[1])
    (low_x, low_y), (high_x, high_y) = floor.min(axis=0) - 0.3, floor.max(axis=0) + 0.3
    for number in range(GOALS):
        rows, images = np.flatnonzero(log["row_goal"] == number), np.flatnonzero(log["image_goal"] == number)
        own, route = world.apply(log["estimated"][rows, :2]), world.apply(log["route"][log["route_goal"] == number])
        true, goal = log["true"][rows], world.apply(log["goal"][number])
        for at in (*range(0, len(rows), STEPS), len(rows) - 1):
            plan.clear()
            seen.clear()
            plan.imshow(
                np.where(space.reachable, 1.0, 0.72), cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent
            )
            plan.plot(*route.T, color="#e0a800", lw=1.5)
            plan.plot(*true[: at + 1, :2].T, color="#444444", lw=1.2)
            plan.add_patch(Circle(true[at, :2].tolist(), 0.105, color="#444444"))
            plan.plot(*goal, "*", color="#119944", ms=15)
            plan.plot(*own[at], "o", color="#dd2222", ms=4)
            away_cm = 100 * np.linalg.norm(own[at] - true[at, :2])
            said = f"off by {away_cm:.1f} cm" if np.isfinite(away_cm) else "not known yet"
            plan.set_title(f"goal {number + 1}: its own position (red) {said}", fontsize=11)
            plan.set(xlim=(low_x, high_x), ylim=(low_y, high_y), xticks=[], yticks=[], aspect="equal")
            before = images[log["image_time_s"][images] <= log["time_s"][rows[at]]]
            seen.imshow(warp_round(log["image"][before[-1] if len(before) else images[0]], warp))
            seen.set_title("all it sees", fontsize=11)
            seen.set_axis_off()
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
            picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
            yield picture, END_MS if at == len(rows) - 1 else FRAME_MS


def animate(run: Path) -> bytes:
    """The animation as a WebP file."""
    log, world = read_arrays(run / "navigate" / f"{METHOD}.npz"), read_alignment(folder_of(run, METHOD))
    pictures, times_ms = zip(*draw_frames(log, world, open_recording(run / "recording")), strict=True)
    pictures[0].save(
        file := BytesIO(), "WEBP", save_all=True, append_images=pictures[1:], duration=times_ms, quality=60
    )
    return file.getvalue()


if __name__ == "__main__":
    write_bytes(Path("docs/navigate.webp"), animate(Path(sys.argv[1])))
