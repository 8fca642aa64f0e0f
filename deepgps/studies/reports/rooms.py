"""The report of rooms: every room, the mean and the worst, and how often DeepGPS beats each baseline."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture
from scipy.stats import binomtest

from deepgps.config.methods import colour_of, title_of
from deepgps.reports.style import count_by_decades
from deepgps.reports.table import tabulate
from deepgps.reports.targets import Figure, mean_of, median_of, ratio_of, share_of, write
from deepgps.studies.table import (
    ACCEPTED,
    ACCEPTED_NOTE,
    ERRORS,
    LEVELS,
    PAPERS_ERRORS,
    Row,
    choose_accepted,
    split_by,
    write_accepted,
    write_errors,
)

OURS = ("deepgps_compass", "deepgps")
"""Methods whose wins are counted, each over those that are not before it."""
SHARES = ("relative_rms", "seen", "flipped")
NOTE = (
    "Errors on the test grid, for the worst heading of each position; aligned on training samples, never scaled. "
    "Seen: share of positions within 0.25 m of a training image. Flipped: share of neighbourhoods that the map flips."
)

SIGN_TEST = "p is from a two-sided sign test: above 0.05, these rooms do not show which of the two is more accurate."


def report(rows: Sequence[Row], varied: Sequence[str]) -> list[str]:
    """A table of all rooms and methods, their means and worst values; a note on it; and how often our methods win."""
    accepted = choose_accepted(rows)
    ours = [*ERRORS.values(), *accepted.values(), "RMS / side", "seen", "flipped", "train [s]"]
    headings, baseline = ["room", "method", *ours, "RMS / PoseNet"], _find_baseline(rows)
    cells = []
    for row in rows:
        known = row["method"] != "posenet" and row["recording"] in baseline
        ratio = row["rms_m"] / baseline[row["recording"]] if known else None
        cells.append([name_room(row, varied), title_of(row["method"]), *_write(row, accepted), write(ratio, "")])
    for title, choose in (("mean", np.mean), ("worst", np.max)):
        for method, group in split_by(rows, "method").items():
            names = (*ERRORS, *accepted, *SHARES, "train_s")
            whole = {name: _choose([row.get(name) for row in group], choose) for name in names}
            for name in ("seen", "accepted") if title == "worst" else ():
                whole[name] = _choose([row.get(name) for row in group], np.min)
            cells.append([title, title_of(method), *_write(whole, accepted), "-"])
    return [tabulate(headings, cells), NOTE, *([ACCEPTED_NOTE] if accepted else []), *_count_wins(rows)]


def measure(rows: Sequence[Row]) -> dict[str, Figure]:
    """The errors of every method over all rooms; for ours also the ratio of mean RMS to PoseNet's over common rooms."""
    methods, baseline, figures = split_by(rows, "method"), _find_baseline(rows), {}
    for method in [*(name for name in OURS[::-1] if name in methods), *(name for name in methods if name not in OURS)]:
        group, own = methods[method], method == "deepgps"
        prefix, title = ("", "") if own else (f"{method}_", f"{title_of(method)}, ")
        found = _measure_errors(group, title)
        both = [(row["rms_m"], baseline[row["recording"]]) for row in group if row["recording"] in baseline]
        if both and method in OURS:
            mine, other = zip(*both, strict=True)
            found["posenet_ratio"] = ratio_of(f"{title}RMS / PoseNet's RMS", mine, other)
            found["wins"] = share_of(f"{title}rooms with RMS below PoseNet's", [one < two for one, two in both])
        if own:
            found["train_s"] = mean_of("training", [row["train_s"] for row in group], "s")
        figures |= {prefix + name: figure for name, figure in found.items()}
    return figures


def draw(rows: Sequence[Row], varied: Sequence[str], folder: Path) -> Picture:
    """Draw RMS (filled) and median (open) of every method in every room."""
    return draw_errors(rows, lambda row: name_room(row, varied))


def draw_errors(rows: Sequence[Row], label: Callable[[Row], str]) -> Picture:
    """Draw RMS (filled) and median (open) of every method, a line for each label of the rows."""
    lines = list(dict.fromkeys(map(label, rows)))
    picture = Picture(figsize=(8, 1.4 + 0.4 * len(lines)), layout="constrained")
    axes = picture.add_subplot()
    for method, group in split_by(rows, "method").items():
        place = [lines.index(label(row)) for row in group]
        colour, title = colour_of(method), title_of(method)
        for name, inside, word in (("rms_m", colour, "RMS"), ("median_m", "none", "median")):
            values = [100 * row[name] for row in group]
            axes.plot(values, place, "o", color=colour, mfc=inside, label=f"{title}, {word}")
    axes.set_yticks(range(len(lines)), lines)
    axes.set(xscale="log", xlabel="error of the worst heading [cm]", ylim=(len(lines) - 0.5, -0.5))
    count_by_decades(axes.xaxis)
    axes.grid(alpha=0.25, which="both")
    picture.legend(frameon=False, fontsize=8, loc="outside upper center", ncols=4)
    return picture


def _choose(values: Sequence[float | None], choose: Callable) -> float | None:
    """One of the values, or None if some are missing."""
    return None if None in values else float(choose(values))


def _measure_errors(group: Sequence[Row], title: str = "") -> dict[str, Figure]:
    figures = {}
    for name, heading in ERRORS.items():
        values = [row[name] for row in group]
        figures[name] = mean_of(title + heading.removesuffix(" [cm]"), values, "cm")
    for name in ("rms_accepted_m", "max_accepted_m"):
        if values := [row[name] for row in group if row.get(name) is not None]:
            words = f"{title}{ACCEPTED[name].removesuffix(' [cm]')}, median over rooms"
            figures[name] = median_of(words, values, "cm")
    for level in LEVELS:
        name = f"radius_{level}_holds"
        if values := [row[name] for row in group if row.get(name) is not None]:
            words = f"{title}accepted images within their {level} % radius, median over rooms"
            figures[name] = median_of(words, values, "%", at_least=True)
    return figures


def _count_wins(rows: Sequence[Row]) -> list[str]:
    """A sentence for each of our methods and each baseline: in how many common rooms ours has the lower error."""
    baselines, sentences = split_by(rows, "method"), []
    for own in OURS:
        ours = {row["recording"]: row for row in baselines.pop(own, [])}
        for method, group in baselines.items() if ours else ():
            pairs = [(ours[row["recording"]], row) for row in group if row["recording"] in ours]
            wins = [
                _count(word, [mine[name] - other[name] for mine, other in pairs])
                for name, word in PAPERS_ERRORS.items()
            ]
            sentences.append(
                f"Of {len(pairs)} rooms, {title_of(own)} has lower errors than {title_of(method)} in {', '.join(wins)}."
            )
    return [*sentences, SIGN_TEST] if sentences else []


def _count(word: str, differences: Sequence[float]) -> str:
    """How many differences are negative, and the p-value of a two-sided sign test."""
    wins, losses = sum(value < 0 for value in differences), sum(value > 0 for value in differences)
    chance = binomtest(wins, wins + losses).pvalue if wins + losses else 1.0
    return f"{wins} by {word} (p = {chance:.2g})"


def _find_baseline(rows: Sequence[Row]) -> dict[str, float]:
    return {row["recording"]: row["rms_m"] for row in rows if row["method"] == "posenet"}


def name_room(row: Row, varied: Sequence[str]) -> str:
    """A room by the settings that vary, such as ``bedroom l 31``."""
    return " ".join(str(row[name]) for name in varied)


def _write(row: Mapping, accepted: Iterable[str]) -> list[str]:
    shares = [f"{100 * row['relative_rms']:.2f} %", write(row["seen"], "%"), write(row["flipped"], "%")]
    return [*write_errors(row), *write_accepted([row], accepted), *shares, f"{row['train_s']:.0f}"]
