"""The camera's lean from the images before and after turns in place, and the resampling that sets its images upright.

The lean is measured over all turns of the training drive, and again over the last turns of a drive in use. Smaller
leans than ``LEAST_RAD`` are not corrected, so that the images of a level camera stay as they are.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deepgps.data.turn_images import find_in_place, take_images, turns_with_images
from sim.errors import InputError
from sim.recording.format import Recording
from sim.recording.turns import Turns, from_array
from sim.sensors.camera.lens import make_lens
from sim.sensors.camera.mount import Upright
from sim.sensors.compass.compass import Hypotheses, find_turns
from sim.sensors.compass.lean import compare_at_horizon, find_lean
from sim.settings import SimSettings

LEAST_RAD = np.radians(0.1)
"""Leans, or differences of leans, up to this are not corrected [rad]."""
LAST_TURNS = 5
"""Turns in place from which the lean in use is measured."""
MOST_TURNS = 100
"""Turns in place from which the lean of the training drive is measured, spread evenly over it."""
ROUNDS = 5
"""Most corrections of the lean: of two images that lean by many degrees apart, one fit finds only a part of it."""


class SeenTurns(NamedTuple):
    """What the images before and after some turns tell.

    Attributes:
        hypotheses: Of the angles turned by the robot, corrected for the camera's lean.
        upright: What sets its images upright, however small its lean is.
    """

    hypotheses: Hypotheses
    upright: Upright


def compare_images(recording: Recording, turns: Turns | None = None, trained: Upright | None = None) -> SeenTurns:
    """Compare the images before and after each turn of a recording, or some of its turns.

    Images of a camera that leans are set upright and compared again, until the lean that is left is small.

    Args:
        recording: With images after turns.
        turns: Some of its turns; None: all.
        trained: Where the lean begins, and the parallax, which lasts: the lean is then that of all rings less the
            parallax, which takes fewer turns. None: the lean is measured near the horizon, without parallax.

    Raises:
        InputError: The recording has no turns or no polar images.
    """
    if (recorded := turns_with_images(recording)) is None:
        raise InputError(
            f"{recording.folder} has no images after turns (turns.npy), which a compass needs; deepgps learns without"
        )
    turns = recorded if turns is None else turns
    before, after = take_images(recording, turns)
    some = find_in_place(turns)
    some = some[:: -(-len(some) // MOST_TURNS) or 1]
    lens = make_lens(SimSettings.model_validate(recording.manifest.settings).camera)
    upright = trained or Upright(lens, (0.0, 0.0))
    for _ in range(ROUNDS):
        one, two = upright(before), upright(after)
        seen, hidden = find_turns(one, two, lens), float(np.linalg.norm(upright.lean))
        apparent = _find_lean(Hypotheses(*(array[some] for array in vars(seen).values())))
        step, parallax = apparent - upright.parallax, np.array(upright.parallax)
        if trained is None:
            step = _find_lean(compare_at_horizon(one[some], two[some], seen.angle[some, 0], lens, hidden))
            parallax = apparent - step
        upright = Upright(lens, _pair(upright.lean + step), _pair(parallax))
        if np.linalg.norm(step) <= LEAST_RAD:
            break
    else:  # the lean has changed since
        seen = find_turns(upright(before), upright(after), lens)
    return SeenTurns(seen, upright)


def _find_lean(hypotheses: Hypotheses) -> np.ndarray:
    """Lean (2,) [rad]; zero where no turn shows it."""
    return np.nan_to_num(find_lean(hypotheses))


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def ignore_small(upright: Upright) -> Upright:
    """The same, but images of a camera that leans by ``LEAST_RAD`` or less stay as they are."""
    return replace(upright, lean=(0.0, 0.0)) if np.linalg.norm(upright.lean) <= LEAST_RAD else upright


def adapt_upright(trained: Upright, drive: Recording) -> tuple[Upright, tuple[float, float] | None]:
    """What sets the images of a drive in use upright, whose camera may have been knocked since training.

    Args:
        trained: What does in training.
        drive: The drive in use.

    Returns:
        That of training unless the lean has changed by more than ``LEAST_RAD``, and the lean in use (2,) [rad]; None
        where the drive has fewer than ``LAST_TURNS`` turns in place.
    """
    turns = turns_with_images(drive)
    if turns is None or len(last := find_in_place(turns)[-LAST_TURNS:]) < LAST_TURNS:
        return trained, None
    found = compare_images(drive, from_array(turns.array[last]), trained).upright
    changed = np.linalg.norm(np.subtract(found.lean, trained.lean)) > LEAST_RAD
    return (found if changed else trained), found.lean


def describe_lean(lean: tuple[float, float]) -> dict[str, float]:
    """Entries for ``training.json`` and ``metrics.json`` of a lean (2,) [rad]."""
    roll, pitch = np.degrees(lean)
    return {"lean_roll_deg": round(float(roll), 4), "lean_pitch_deg": round(float(pitch), 4)}
