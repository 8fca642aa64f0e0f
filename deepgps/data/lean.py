"""The camera's lean from the images before and after turns in place, and the resampling that sets its images upright.

The lean is measured over all turns of the training drive, and again over the last turns of a drive in use. Smaller
leans than ``LEAST_RAD`` are not corrected, so that the images of a level camera stay as they are.
"""

from typing import NamedTuple

import numpy as np

from sim.errors import InputError
from sim.recording.format import Recording
from sim.recording.turns import KINDS, NO_IMAGE, Turns
from sim.sensors.compass import Hypotheses, find_turns
from sim.sensors.compass_lean import find_lean
from sim.sensors.lens import Lens, make_lens
from sim.sensors.upright import Upright
from sim.settings import SimSettings

LEAST_RAD = np.radians(0.1)
"""Leans, or differences of leans, up to this are not corrected [rad]."""
LAST_TURNS = 5
"""Turns in place from which the lean in use is measured."""
ROUNDS = 5
"""Most corrections of the lean: of two images that lean by many degrees apart, one fit finds only a part of it."""


class SeenTurns(NamedTuple):
    """What the images before and after some turns tell.

    Attributes:
        hypotheses: Of the angles turned by the robot, corrected for the camera's lean.
        lean: Lean of the camera (2,) [rad] to the robot's right and forward.
    """

    hypotheses: Hypotheses
    lean: np.ndarray


def compare_images(recording: Recording, turns: Turns | None = None) -> SeenTurns:
    """Compare the images before and after each turn of a recording, or some of its turns.

    Images of a camera that leans are set upright and compared again, until the lean that is left is small.

    Raises:
        InputError: The recording has no turns or no polar images.
    """
    if recording.turns is None or recording.turn_observation is None or recording.kind != "polar_image":
        raise InputError(
            f"{recording.folder} has no images after turns (turns.npy), which a compass needs; deepgps learns without"
        )
    turns = recording.turns if turns is None else turns
    before = recording.observation[turns.before]
    after, taken = recording.observation[recording.reading[turns.after, 1]], turns.image != NO_IMAGE
    after[taken] = recording.turn_observation[turns.image[taken]]
    lens, in_place = lens_of(recording), find_in_place(turns)
    lean = np.zeros(2)
    for _ in range(ROUNDS):
        upright = Upright(lens, (float(lean[0]), float(lean[1])))
        seen = find_turns(upright(before), upright(after), lens)
        step = _measure_lean(seen, in_place)
        lean = lean + step
        if np.linalg.norm(step) <= LEAST_RAD:
            break
    return SeenTurns(seen, lean)


def lens_of(recording: Recording) -> Lens:
    """The lens of a recording's polar images."""
    return make_lens(SimSettings.model_validate(recording.manifest.settings).camera)


def find_in_place(turns: Turns) -> np.ndarray:
    """Indices of the turns in place with an image after them."""
    return np.flatnonzero((turns.kind == KINDS.index("in_place")) & (turns.image != NO_IMAGE))


def _measure_lean(hypotheses: Hypotheses, some: np.ndarray) -> np.ndarray:
    """Lean (2,) [rad] from the turns with these indices; zero where they tell none."""
    arrays = (hypotheses.angle, hypotheses.std, hypotheses.weight, hypotheses.lean)
    return np.nan_to_num(find_lean(Hypotheses(*(array[some] for array in arrays))))


def choose_upright(recording: Recording, lean: np.ndarray) -> Upright:
    """The resampling that sets images of a camera with this lean (2,) [rad] upright; none if the lean is small."""
    small = np.linalg.norm(lean) <= LEAST_RAD
    return Upright(lens_of(recording), (0.0, 0.0) if small else (float(lean[0]), float(lean[1])))


def adapt_upright(upright: Upright, drive: Recording) -> tuple[Upright, np.ndarray | None]:
    """The resampling for a drive in use, whose camera may have been knocked since training.

    Args:
        upright: The resampling of training.
        drive: The drive in use.

    Returns:
        Its resampling, which is that of training unless the lean has changed, and its lean (2,) [rad]; None where it
        has fewer than ``LAST_TURNS`` turns in place.
    """
    if drive.turns is None or drive.turn_observation is None:
        return upright, None
    last = find_in_place(drive.turns)[-LAST_TURNS:]
    if len(last) < LAST_TURNS:
        return upright, None
    lean = compare_images(drive, Turns(*drive.turns.array[last].T)).lean
    changed = np.linalg.norm(lean - upright.lean) > LEAST_RAD
    return (choose_upright(drive, lean) if changed else upright), lean


def describe_lean(lean: np.ndarray) -> dict[str, float]:
    """Entries for ``training.json`` and ``metrics.json`` of a lean (2,) [rad]."""
    roll, pitch = np.degrees(lean)
    return {"lean_roll_deg": round(float(roll), 4), "lean_pitch_deg": round(float(pitch), 4)}
