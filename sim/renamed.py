"""What older runs and recordings mean: names that changed with schema 2, and settings that they do not have."""

from collections.abc import Callable, Mapping
from typing import Any

SETTINGS: dict[str, str | None] = {
    "use": "deployment",
    "image": "image_faults",
    "mount": "camera_mount",
    "horizontal": "tag_camera",
    "map": "obstacles",
    "map.obstacles": "obstacles.count",
    "map.carried": "obstacles.relocate_after",
    "encoder.gap_noise": "encoder.step_noise",
    "encoder.lost": "encoder.dropout",
    "encoder.stuck": "encoder.stuck_fraction",
    **dict.fromkeys(
        [
            *("learn.lift.flatten_from", "learn.lift.flatten_to", "learn.fold.bent", "learn.fold.doubled"),
            *("learn.neighbours", "learn.pca.components", "learn.label_noise_m"),
            *("robot.timestep_s", "drive.control_period_s"),
        ]
    ),
}
"""Old to new dotted names of settings and groups; None: now a constant."""
METHODS = {
    "deepgps_aware": "deepgps_noise_aware",
    "deepgps_turns": "deepgps_with_turns",
    "odometry": "dead_reckoned_labels",
}
WORLDS = {"lidar": "obstacles"}
COLUMNS = {"fold_bent": "length_error_fraction", "fold_doubled": "overlap_fraction", "map_off": "misplaced"}
"""Columns of a study's table that are not settings."""


def name_now(dotted: str) -> str | None:
    """Return the current name of a setting; None if it is now a constant. Unchanged names are returned as they are."""
    head, tail = dotted, ""
    while head not in SETTINGS:
        head, _, last = head.rpartition(".")
        tail = f".{last}{tail}"
        if not head:
            return dotted
    found = SETTINGS[head]
    return found if found is None else found + tail


def explain_setting(dotted: str, spell: Callable[[str], str] = str) -> str | None:
    """Explain in a message what became of a renamed setting, names spelled by ``spell``; None: it was not renamed."""
    if (now := name_now(dotted)) == dotted:
        return None
    inner = [f"{spell(old)} is {spell(new)}" for old, new in SETTINGS.items() if old.startswith(f"{dotted}.") and new]
    return "it is a constant now" if now is None else "; ".join([f"it is called {spell(now)} now", *inner])


def explain_value(dotted: str, value: object) -> str | None:
    """Explain in a message what became of a method's or a world's name; None if it was not renamed."""
    table = METHODS if dotted.startswith("methods") else WORLDS if dotted == "world" else {}
    return f"it is called {table[value]} now" if isinstance(value, str) and value in table else None


def method_now(name: Any) -> Any:
    """Return the current name of a method; anything else is returned as it is."""
    return METHODS.get(name, name) if isinstance(name, str) else name


def name_methods(values: Mapping[str, Any]) -> dict[str, Any]:
    """Translate an older run's values by method to the methods' current names."""
    return {method_now(name): value for name, value in values.items()}


def translate(values: Mapping[str, Any]) -> dict[str, Any]:
    """Translate an older run's nested settings to current names."""
    made: dict[str, Any] = {}
    for dotted, value in _leaves(values):
        if (now := name_now(dotted)) is None:
            continue
        *groups, last = now.split(".")
        group = made
        for name in groups:
            if not isinstance(group.get(name), dict):  # two old names may give a group and a value one name
                group[name] = {}
            group = group[name]
        group[last] = value
    if isinstance(made.get("world"), str):
        made["world"] = WORLDS.get(made["world"], made["world"])
    if isinstance(made.get("methods"), list):
        made["methods"] = [method_now(name) for name in made["methods"]]
    return complete(made)


def complete(values: Mapping[str, Any]) -> dict[str, Any]:
    """Add to the resolved settings of a run in a room what they mean where they are older than ``drive.headings``."""
    drive = values.get("drive")
    if values.get("world", "room") != "room" or not isinstance(drive, Mapping):
        return dict(values)
    return {**values, "drive": {"headings": "random", **drive}}


def translate_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Translate a row of an older study's table to current names."""
    made = {COLUMNS.get(name) or name_now(name) or name: value for name, value in row.items()}
    if "method" in made:
        made["method"] = method_now(made["method"])
    return made


def translate_study(values: Mapping[str, Any]) -> dict[str, Any]:
    """Translate an older study to current names: the settings that it varies, and its methods."""
    made = {name: value for name, value in values.items() if name != "record"}  # recordings are made when viewed
    for name in ("set", "axes"):
        if isinstance(values.get(name), Mapping):
            made[name] = _translate_dotted(values[name])
    if isinstance(values.get("cases"), list):
        made["cases"] = [_translate_dotted(case) if isinstance(case, Mapping) else case for case in values["cases"]]
    if isinstance(values.get("methods"), list):
        made["methods"] = [method_now(name) for name in values["methods"]]
    return made


def _translate_dotted(values: Mapping[str, Any]) -> dict[str, Any]:
    return {now: value for name, value in values.items() if (now := name_now(str(name))) is not None}


def _leaves(values: Mapping[str, Any], before: str = "") -> list[tuple[str, Any]]:
    found = []
    for name, value in values.items():
        inner = isinstance(value, Mapping) and value
        found += _leaves(value, f"{before}{name}.") if inner else [(f"{before}{name}", value)]
    return found
