"""The short help of the commands that take a scenario, for a first reader; ``--help-all`` shows every setting."""

from textwrap import wrap
from typing import get_args

from deepgps.config.methods import METHODS
from deepgps.config.scenario import Scenario, names_in
from deepgps.config.spelling import as_option, find_group, find_type
from sim.files import SCENARIOS

OPTIONS = (
    ("--out FOLDER", "run folder; else runs/SCENARIO/seedN-HASH"),
    ("--fresh", "make the run again, then replace the old one"),
    ("--live [HOST:PORT]", "show the run while it is in progress"),
    ("--log FILE", "also write the drive as a robot's log (MCAP)"),
    ("--plugin FILE ...", "methods and encoder faults of your own"),
)
FIRST_SETTINGS = {
    "seed": "seed of driving, sensors and weights",
    "methods": "methods to train and compare",
    "room.kind": "living_room, bedroom, office, kitchen, ...",
    "room.mjcf": "an MJCF file of your own as the room",
    "drive.samples": "images to collect",
    "encoder.ticks_per_rev": "resolution of the wheel encoders",
    "encoder.step_noise": "noise of each distance, as a fraction of it",
    "image_faults.read_noise": "noise of the camera in the dark, of white",
    "deployment.light": "light in deployment, over that in training",
    "learn.train.steps": "steps of each training",
}
"""Settings that most users change first, with what they are."""


COLUMNS = 80


def write_help(command: str, about: str | None) -> str:
    """The help of a command that takes a scenario: usage, an example, its options, and the settings to begin with."""
    rows = [*OPTIONS, *((f"{as_option(name)} {_name_value(name)}", text) for name, text in FIRST_SETTINGS.items())]
    wide = max(len(option) for option, _ in rows) + 2
    options = [f"  {option:<{wide}}{text}" for option, text in rows]
    groups = [as_option(name)[2:] for name, field in Scenario.model_fields.items() if find_group(field.annotation)]
    names = ", ".join(names_in(SCENARIOS))
    own = [name for name, method in METHODS.items() if not method.is_baseline]
    return "\n".join(
        [
            f"usage: deepgps {command} SCENARIO [--SETTING VALUE ...]",
            f"example: deepgps {command} living_room --room.seed 3 --encoder.step-noise 0.1",
            "",
            about or "",
            *_wrap(f"SCENARIO is {names}, a YAML file of your own, or the folder of a run or a recording."),
            "",
            *options[: len(OPTIONS)],
            "",
            "Settings to begin with; a scenario gives the others their values:",
            *options[len(OPTIONS) :],
            "",
            *_wrap(f"Methods: {', '.join(own)}; baselines: {', '.join(name for name in METHODS if name not in own)}."),
            "",
            f"deepgps {command} --help GROUP shows a group of settings, --help-all all groups:",
            *_wrap(", ".join(groups)),
        ]
    )


def _wrap(text: str) -> list[str]:
    return wrap(text, COLUMNS, subsequent_indent="  ", break_on_hyphens=False)


def _name_value(dotted: str) -> str:
    """What to write after a setting: N for a whole number, X for a number, FILE, KIND or METHOD ..."""
    if dotted == "methods":
        return "METHOD ..."
    kind = find_type(dotted, Scenario)
    if kind in {int, float}:
        return "N" if kind is int else "X"
    return "FILE" if str in get_args(kind) else dotted.rpartition(".")[2].upper()
