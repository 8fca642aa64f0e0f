"""Settings of the training drive and of the test grid."""

from typing import Literal

from pydantic import Field

from sim.settings.group import Group, WithLater

FEWEST_SAMPLES = 16
"""Fewest images of a drive."""
TURN_RATE_RPS = 1.8
"""Speed of turns in place [rad/s] (TurtleBot3 Burger: at most 2.84)."""


class DriveSettings(WithLater):
    """How the robot drives and when it looks."""

    later = frozenset({"mixed_light", "arcs"})

    strategy: Literal["dense", "endpoint"] = "dense"
    """dense: an image every spacing_m; endpoint: images only where a straight segment begins and ends."""
    samples: int = Field(default=8000, ge=FEWEST_SAMPLES, le=2_000_000)
    """Images to collect."""
    spacing_m: float = Field(default=0.08, ge=0.01, le=1.0)
    """Distance between images on a segment [m]; in a room, images are never closer than the robot drives in 0.04 s."""
    speed_mps: float = Field(default=0.22, gt=0.01, le=0.5)
    """Cruising speed [m/s] (TurtleBot3 Burger: 0.22)."""
    longest_m: float = Field(default=5.0, ge=0.2, le=50.0)
    """Longest straight segment [m]."""
    lengths: Literal["longest", "random"] = "longest"
    """longest: each segment is as long as possible; random: each draws its own length up to longest_m, so that it ends
    at a random place, as the paper's end-point strategy requires."""
    turn_images: bool = True
    """Whether the robot takes a second image after each turn in place, from which the angle turned is measured; these
    are not counted in samples."""
    headings: Literal["explore", "random"] = "explore"
    """explore: of twelve random headings the robot takes the one over the floor that it visited longest ago, by its
    wheels; random: it takes any heading, as in the paper."""
    enter: float = Field(default=0.2, ge=0.0, le=1.0)
    """Probability of turning into an opening that the robot passes. A robot that explores always turns into an opening
    if it visited the floor behind it longer ago than the floor ahead."""
    search: float = Field(default=0.05, ge=0.0, le=1.0)
    """Probability, after a segment, of searching one side for a while for places that random driving would miss."""
    mixed_light: bool = False
    """Whether the light changes during the training drive, at the first end of a segment after every 256 images: as
    usual, little daylight, lamps off, night."""
    arcs: float = Field(default=0.0, ge=0.0, le=0.9)
    """Probability, before a segment, of driving an arc first, on which no image is taken; only logs show it."""


class GridSettings(Group):
    """The test grid, rendered while collecting so that nothing later needs the simulator."""

    spacing_m: float = Field(default=0.08, ge=0.005, le=1.0)
    """Distance between test positions [m]; with landmarks, rounded so that it divides the side."""
    headings: int = Field(default=4, ge=1, le=64)
    """Headings at each test position, evenly spaced from +x."""
    held_out: int = Field(default=0, ge=0, le=100_000)
    """Held-out samples, driven after the training samples, that replace the grid as test positions; 0: the grid."""
