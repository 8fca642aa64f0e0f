"""Draw the picture of the page "Explore a home" from a drive by map.

``.venv/bin/deepgps collect flat --room.seed 740 --drive.until.unseen 0.005 --out runs/home``, then
``.venv/bin/python -m docs.explore_picture runs/home``.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from deepgps.evaluation.measures import SEEN_RADIUS_M, find_seen
from deepgps.reports.plots import to_png
from docs.pictures import PICTURES, reduce
from sim.files.atomic import write_bytes
from sim.recording.format import Truth, open_truth

PARTS = (0.1, 0.3, 1.0)  # Parts of the drive that are shown


def draw_drive(truth: Truth) -> Figure:
    """The floor within reach, what parts of the drive have seen of it, and their way, later images lighter."""
    figure, space, place = Figure(figsize=(13, 4.6), layout="constrained"), truth.free_space, truth.pose[:, :2]
    floor = space.places()
    ends = np.array(space.reachable.shape[::-1]) * space.cell_m
    extent = (space.origin[0], space.origin[0] + ends[0], space.origin[1], space.origin[1] + ends[1])
    low, high = floor.min(axis=0) - 0.4, floor.max(axis=0) + 0.4
    for axes, part in zip(figure.subplots(1, len(PARTS)), PARTS, strict=True):
        so_far = place[: round(part * len(place))]
        seen, picture = find_seen(floor, so_far), np.ones((*space.reachable.shape, 3))
        picture[space.reachable] = np.where(seen[:, None], (0.86, 0.92, 0.86), (0.96, 0.72, 0.62))
        axes.imshow(picture, origin="lower", extent=extent)
        axes.scatter(*so_far.T, s=1.2, c=np.arange(len(so_far)), cmap="viridis", linewidths=0)
        axes.set_title(f"{len(so_far):,} images: {100 * (1 - seen.mean()):.1f} % unseen", fontsize=12)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[], frame_on=False)
    figure.supxlabel(f"red: floor without an image within {SEEN_RADIUS_M:g} m; dots: images, the last ones lightest")
    return figure


if __name__ == "__main__":
    figure = draw_drive(open_truth(Path(sys.argv[1]) / "recording"))
    write_bytes(PICTURES / "explore.png", reduce(to_png(figure)))
