"""Whether a run's figures can be believed: what shows that a method did not converge, or that the run is only a try."""

from collections.abc import Mapping
from typing import Any

from deepgps.config.methods import title_of

SCALE_LIMITS = (0.9, 1.1)
"""Scales of a map beyond these are no error of the encoders."""
LARGEST_RELATIVE_RMS = 0.1
"""RMS, as a fraction of the room's shorter side, from which a map is of no use."""
LARGEST_TURNED = 0.03
"""Part of the way that may be mirrored or turned in a right map: images taken for a place that looks alike. In twenty
worlds of corridors and labyrinths it was at most 1.4 % in right maps by distances alone, 4 to 55 % in wrong ones."""
LEAST_SEEN = 0.9
"""Fraction of the test positions near a training observation below which the drive is too short."""
TRY_OUT = "This is a small run that shows the way only; its errors have no meaning."


def judge_run(metrics: Mapping[str, Any]) -> list[str]:
    """Sentences on what is wrong with a run's results, one for all its methods and one for its drive; often none."""
    doubts = {title_of(name): find_doubts(values) for name, values in metrics["methods"].items()}
    doubtful = [f"{title} ({', '.join(reasons)})" for title, reasons in doubts.items() if reasons]
    sentences = [f"Not converged: {'; '.join(doubtful)}."] if doubtful else []
    for name, values in metrics["methods"].items():
        turned = values.get("turned", {})
        if (part := describe_turned(turned)) and turned["share"] <= LARGEST_TURNED:
            sentences.append(f"{title_of(name)}: {part}.")
        if undecided := describe_undecided(values.get("map", {})):
            sentences.append(f"{title_of(name)}: {undecided}")
    if missed := describe_missed(metrics.get("coverage", {})):
        sentences.append(missed)
    if metrics.get("scenario") == "tiny":
        sentences.append(TRY_OUT)
    return sentences


def find_doubts(method: Mapping[str, Any]) -> list[str]:
    """Reasons why a method's map cannot be right, from its figures in ``metrics.json``."""
    low, high = SCALE_LIMITS
    scale, rms, fold = method.get("scale"), method.get("relative_rms"), method.get("fold")
    reasons = []
    if scale is not None and not low <= scale <= high:
        reasons.append(f"scale {scale:.2f}")
    if isinstance(fold, Mapping) and fold.get("found"):
        reasons.append("the map is folded")
    turned = method.get("turned", {})
    if (reason := describe_turned(turned)) and turned["share"] > LARGEST_TURNED:
        reasons.append(reason)
    if rms is not None and rms > LARGEST_RELATIVE_RMS:
        reasons.append(f"RMS {100 * rms:.0f} % of the room's shorter side")
    return reasons


def describe_undecided(found: Mapping[str, Any]) -> str | None:
    """Say in a sentence how much of a map is undecided, and why; None: nothing is, or there is no such map.

    Args:
        found: The map's part of ``metrics.json``, or of ``training.json``.
    """
    share, parts, repeats_m = found.get("undecided", 0.0), found.get("parts", []), found.get("repeats_m")
    if not share or not parts:
        return None
    first, last = max(parts, key=lambda part: part[1] - part[0])
    pieces = (
        f"images {first} to {last}" if len(parts) == 1 else f"{len(parts)} parts; longest: images {first} to {last}"
    )
    because = f"; the world repeats every {repeats_m:.1f} m" if repeats_m else ""
    if "repeats_m" not in found:
        because = "; segments cross it along one line only, so it could be mirrored: drive more, or use the compass"
    return f"{max(100 * share, 0.1):.1f} % of its map is undecided ({pieces}){because}."


def describe_turned(turned: Mapping[str, Any]) -> str | None:
    """Say which part of a map goes another way than the compass saw; None: no part, or nothing is known.

    Args:
        turned: What ``describe_parts`` gives; empty without turn images.
    """
    if not turned.get("parts"):
        return None
    parts = turned["parts"]
    images = f"{sum(parts)} images" if len(parts) == 1 else f"{len(parts)} parts with {sum(parts)} images"
    return f"{images}, {max(100 * turned['share'], 0.1):.1f} % of the way, are mirrored or turned by the compass"


def describe_missed(coverage: Mapping[str, Any]) -> str | None:
    """Say in a sentence how much of the room, and which part, the drive has missed; None: little."""
    reachable = coverage.get("reachable_cells", 0)
    if not reachable or coverage["cells_seen"] >= LEAST_SEEN * reachable:
        return None
    share = 100 * (1 - coverage["cells_seen"] / reachable)
    part = f", mostly in the {coverage['missed']}" if coverage.get("missed") else ""
    return f"The drive missed {share:.0f} % of the room{part}: drive more, with --drive.samples."
