"""The alignment that evaluation fits on the truth, stored with each method: it carries predictions into the world.

Only what reports results in the world's frame opens it: evaluation, the Python interface, the viewer, and the commands
that track, locate and export. Nothing may learn or estimate a pose with it, since it was fitted on the truth.
"""

import shlex
from pathlib import Path

import numpy as np

from deepgps.positioner.stored_positioner import INDEX
from sim.alignment import Alignment, AlignmentKind
from sim.errors import InputError
from sim.files.checksums import read_json, write_json

FILE = "alignment.json"


def has_alignment(folder: Path) -> bool:
    """Whether a method's folder holds an alignment."""
    return (folder / FILE).is_file()


def write_alignment(folder: Path, alignment: Alignment, kind: AlignmentKind) -> None:
    """Write the alignment of a method's map with the world, and the kind of transform that was fitted."""
    values = {
        "fitted_on": "truth",
        "kind": kind,
        "rotation": alignment.rotation.tolist(),
        "translation_m": alignment.translation.tolist(),
        "scale": alignment.scale,
        "positioner": _fingerprint(folder),
    }
    write_json(folder / FILE, values)


def read_alignment(folder: Path) -> Alignment:
    """Read the alignment of a method's map; raises InputError if it is not evaluated, or was trained again since."""
    path = folder / FILE
    words = (str(folder.parent / "scenario.yaml"), "--out", str(folder.parent))
    evaluate = f"deepgps evaluate {shlex.join(words)} writes it"
    if not path.is_file():
        raise InputError(f"{folder} has no {FILE}, so its map has no place in the world; {evaluate}")
    values = read_json(path)
    if values["positioner"] != _fingerprint(folder):
        raise InputError(f"{path} belongs to an earlier training; delete it, and {evaluate}")
    return Alignment(np.array(values["rotation"]), np.array(values["translation_m"]), values["scale"])


def _fingerprint(folder: Path) -> str | None:
    """The checksum of the weights, which distinguishes one training from another."""
    return read_json(folder / INDEX).get("sha256")
