"""How much of a log's drive its images show, and how much of the polar images the camera sees."""

import numpy as np

from deepgps.robot_io.logs.drive import LoggedDrive
from deepgps.robot_io.logs.polar import PolarSource

MOST = 0.95
"""Part of the drive that images must cover, and part of the images that must be taken during it; else it is noted."""
GAP_S, GAPS = 1.0, 5.0
"""Time between two images in which the drive is not seen [s], if it is also this multiple of the usual time."""
REACH = 0.9
"""Part of the polar image's angle that the camera must see all around; otherwise it is noted."""


def note_cover(topic: str, drive: LoggedDrive) -> list[str]:
    """Notes if images are missing in a part of the drive, which is not used, or were taken outside of it."""
    begin_s, end_s = drive.wheels.time_s[[0, -1]]
    image_s = np.sort(drive.image_s[np.isfinite(drive.image_s)])
    seen_s = image_s[(image_s >= begin_s) & (image_s <= end_s)]
    if not len(seen_s):
        return []
    notes, step = [], np.diff(seen_s)
    gap = step > max(GAP_S, GAPS * float(np.median(step)) if len(step) else 0.0)
    covered_s = float(step[~gap].sum())
    if covered_s < MOST * (end_s - begin_s):
        longest = f", without {step.max():.0f} s from {seen_s[np.argmax(step)]:.1f} s on" if gap.any() else ""
        notes.append(
            f"{topic}: images cover {covered_s:.0f} of {end_s - begin_s:.0f} s of the drive, from {seen_s[0]:.1f} to "
            f"{seen_s[-1]:.1f} s{longest}; the rest is not used"
        )
    if len(seen_s) < MOST * len(image_s):
        notes.append(
            f"{topic}: {len(image_s) - len(seen_s)} of {len(image_s)} images were taken before or after the wheels "
            "were logged, and are left out"
        )
    return notes


def note_reach(source: PolarSource) -> list[str]:
    """A note if polar images go further from the optical axis than the camera's images do."""
    reach, half = source.camera.find_half_angle(), source.lens.half_angle
    if reach >= REACH * half:
        return []
    return [
        f"{source.topic}: images reach {np.degrees(reach):.0f} deg from the optical axis all around it, and polar "
        f"images {np.degrees(half):.0f}, so these are black in part: are circle_px and field_of_view_deg right?"
    ]
