"""What is known of a run without truth, as text: a table and sentences, for the terminal and the viewer."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from deepgps.config.methods import title_of
from deepgps.evaluation.without_truth import read_judged
from deepgps.reports import table
from deepgps.reports.table import Column, choose, fill, head, write_hundredths
from deepgps.tracking.causes import describe_causes
from sim.errors import InputError

NO_ERRORS = "There is no ground truth, so no figure here is an error of a position."


COLUMNS: tuple[Column, ...] = (
    ("length, RMS [cm]", "length_rms_m", write_hundredths),
    ("length, accepted [cm]", "length_rms_accepted_m", write_hundredths),
    ("length, median [cm]", "length_median_m", write_hundredths),
    ("off the line [cm]", "straight_rms_m", write_hundredths),
    ("scale", "scale", lambda value: f"{value:.4f}"),
    ("turns [deg]", "turn_rms_deg", lambda value: f"{value:.2f}"),
    ("accepted [%]", "accepted", write_hundredths),
    ("radius 68 % [cm]", "radius_68_median_m", write_hundredths),
)
"""Heading, key of a method's figures on what is held out, and how a value is written."""


def print_without_truth(run: Path, console: Console) -> bool:
    """Print what is known of a run; returns whether it is one without truth."""
    found = read_judged(run)
    if found is None:
        return False
    headings, rows = tabulate(found)
    table.print_table(console, headings, rows)
    console.print()
    table.say(console, *describe(found))
    return True


def tabulate(found: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and one row per method, of the segments held out or, if there are none, of those trained on."""
    kind = "held_out" if "held_out" in found else "segments"
    figures = {name: values.get(kind, {}) for name, values in found["methods"].items()}
    columns = choose(COLUMNS, figures.values())
    return ("method", *head(columns)), [(title_of(name), *fill(columns, one)) for name, one in figures.items()]


def markdown(run: Path) -> str:
    """The table and the sentences in Markdown; raises InputError if the run has not been judged."""
    found = read_judged(run)
    if found is None:
        raise InputError(f"{run} has not been evaluated without truth")
    headings, rows = tabulate(found)
    return "\n\n".join([table.tabulate(headings, rows), *describe(found)])


def describe(found: Mapping[str, Any]) -> list[str]:
    """What was driven, what the table holds, and what each method knows of its own map."""
    held_out = found.get("held_out")
    summary = (
        f"{found['samples']} observations on {found['segments']} straight segments, {found['distance_driven_m']:.0f} m"
    )
    if held_out:
        summary += (
            f"; held out and in the table: {held_out['samples']} on {held_out['segments']}, "
            f"{held_out['distance_driven_m']:.0f} m"
        )
    else:
        summary += "; none are held out, so the table tells only how well the segments were learned"
    sentences = [f"{summary}.", NO_ERRORS]
    causes = (one.get("held_out", {}).get("causes") for one in found["methods"].values())
    sentences += [describe_causes(one) for one in causes if one is not None][:1]
    if (wheels := found.get("wheels")) is not None:
        sentences.append("Wheels: " + (" ".join(wheels) or "nothing is wrong with them, as far as can be known."))
    return [*sentences, *filter(None, (_describe_method(name, one) for name, one in found["methods"].items()))]


def _describe_method(name: str, values: Mapping[str, Any]) -> str | None:
    """Signs of a fold, what the map expects of itself, the camera's lean."""
    parts = []
    if values.get("fold", {}).get("found"):
        parts.append("its map looks folded")
    known_map = values.get("map", {})
    if known_map.get("expected_rms_m") is not None:
        parts.append(f"its map expects an RMS error of {100 * known_map['expected_rms_m']:.1f} cm of itself")
    if known_map.get("undecided"):
        parts.append(f"{100 * known_map['undecided']:.1f} % of its map is undecided")
    if known_map.get("believed") is not None:
        parts.append(f"{100 * known_map['believed']:.1f} % of its loop closures agree")
    if values.get("lean_roll_deg") is not None:
        parts.append(
            f"the camera leans {values['lean_roll_deg']:.2f} deg right, {values['lean_pitch_deg']:.2f} deg forward"
        )
    return f"{title_of(name)}: {'; '.join(parts)}." if parts else None
