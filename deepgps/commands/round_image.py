"""The options that say where the image circle lies in raw images."""

from typing import TYPE_CHECKING, Annotated

import tyro

from sim.errors import InputError

if TYPE_CHECKING:
    from sim.sensors.camera.unwrap import RoundImage

Centre = Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="COLUMN ROW")]
Radius = Annotated[float | None, tyro.conf.arg(metavar="PX")]
Forward = Annotated[float, tyro.conf.arg(metavar="DEG")]


def parse_round_image(centre: Centre, radius_px: Radius, forward_deg: Forward) -> "RoundImage | None":
    """Where the image circle is in raw images; None: it is not given."""
    if centre is None and radius_px is None:
        if forward_deg:
            raise InputError("--forward-deg needs --centre and --radius-px")
        return None
    if centre is None or radius_px is None:
        raise InputError("--centre and --radius-px: give both, or neither")
    from sim.sensors.camera.unwrap import LARGEST_PX, MOST_DEG, RoundImage

    if not all(0 <= place <= LARGEST_PX for place in centre):
        written = " ".join(f"{place:g}" for place in centre)
        raise InputError(f"--centre {written}: must be column and row, each from 0 to {LARGEST_PX} px")
    if not 1 <= radius_px <= LARGEST_PX:
        raise InputError(f"--radius-px {radius_px:g}: must be from 1 to {LARGEST_PX} px")
    if not abs(forward_deg) <= MOST_DEG:  # also refuses NaN
        raise InputError(f"--forward-deg {forward_deg:g}: must be from -{MOST_DEG} to {MOST_DEG}")
    return RoundImage(centre, radius_px, forward_deg)
