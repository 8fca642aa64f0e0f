"""The field of view of polar images, which must be the same where a method learns and where it is used."""

from sim.errors import InputError
from sim.recording.format import Recording

MOST_APART_DEG = 2.0
"""Difference of two fields of view that moves no pixel by more than a ring or so [deg]."""


def find_view(recording: Recording) -> float | None:
    """Full angle of a recording's polar images [deg]; None: its manifest does not tell."""
    camera = recording.manifest.settings.get("camera", {})
    return camera.get("field_of_view_deg") if isinstance(camera, dict) else None


def check_view(used_deg: float, learned_deg: float | None) -> None:
    """Raise InputError if images of this field of view are not like those that were learned from; None: unknown."""
    if learned_deg is not None and abs(used_deg - learned_deg) > MOST_APART_DEG:
        raise InputError(
            f"camera.field_of_view_deg {used_deg:g}: the run has learned from images of {learned_deg:g}, so no place "
            "would be found; set the same, or leave it out"
        )
