"""A run's results as text: its table, what they say, and whether they can be trusted."""

from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from rich.console import Console

from deepgps.config.methods import METHODS, title_of
from deepgps.evaluation.error_field import REPAIR_HINT
from deepgps.reports import table
from deepgps.reports.table import Column, choose, fill, head, write_centimetres, write_hundredths
from deepgps.reports.without_truth import print_without_truth
from deepgps.runs.provenance import stage_times
from deepgps.runs.run_folder import METRICS
from deepgps.tracking.causes import describe_causes
from sim.errors import DamagedError, InputError
from sim.files.checksums import read_json

Row = tuple[str, ...]

COLUMNS: tuple[Column, ...] = (
    ("RMS [cm]", "rms_m", write_centimetres),
    ("median [cm]", "median_m", write_centimetres),
    ("p75 [cm]", "p75_m", write_centimetres),
    ("p95 [cm]", "p95_m", write_centimetres),
    ("max [cm]", "max_m", write_centimetres),
    ("yaw [deg]", "yaw_rms_deg", lambda value: f"{value:.1f}"),
    ("RMS / side", "relative_rms", lambda value: f"{100 * value:.1f} %"),
    ("scale", "scale", lambda value: f"{value:.3f}"),
    ("align", "alignment", str),
    ("train [s]", "train_s", lambda value: f"{value:.1f}"),
)
"""Columns of the table, which fits into 80 columns of a terminal."""
MIN_LEAN_DEG, MIN_WOBBLE_DEG = 0.1, 0.3  # Smallest lean, and increase of the wobble, that are reported [deg]
COLUMNS_NOTE = "RMS / side: over the room's shorter side; yaw: RMS error of the heading."
OVERVIEW = tuple(column for column in COLUMNS if column[1] in {"rms_m", "median_m", "max_m", "relative_rms"})


def read_metrics(run: Path) -> dict[str, Any]:
    """Read a run's metrics.json; raises InputError for a folder that holds no run."""
    path = run / METRICS
    if not path.is_file():
        raise InputError(f"{run} is not a run: it has no metrics.json (deepgps run writes one)")
    try:
        metrics = read_json(path)
    except DamagedError as error:
        raise DamagedError(f"{error}; {REPAIR_HINT}") from None
    if "methods" not in metrics:
        raise InputError(f"{path} lists no methods: it is not the metrics.json of a run")
    return metrics


def tabulate(metrics: Mapping[str, Any], columns: Sequence[Column] = COLUMNS) -> tuple[Row, list[Row]]:
    """Headings and one row per method, by the map that it learns, with a dash for a figure that it does not have.

    Below the row of a method that refuses images is one with the same errors of what it accepts. The last row is the
    path by the wheels alone.
    """
    methods, order = metrics["methods"], list(METHODS)
    columns = choose(columns, methods.values())
    names = sorted(methods, key=lambda name: order.index(name) if name in order else len(order))
    rows = [row for name in names for row in _rows(name, methods[name], columns)]
    path = metrics.get("trajectory")
    return ("method", *head(columns)), [*rows, *([("Dead reckoning, path", *fill(columns, path))] if path else [])]


def describe(metrics: Mapping[str, Any], times: Mapping[str, float] | None = None) -> list[str]:
    """Describe the drive, the encoders, the coverage, what is accepted, the camera, the deployment drive and the time.

    Seconds of each stage in all sittings are those in the metrics, without ``show``, unless they are given.
    """
    coverage, methods = metrics["coverage"], metrics["methods"]
    seen, reachable = coverage["cells_seen"], coverage["reachable_cells"]
    places = "test samples" if _is_held_out(metrics) else "reachable test positions"
    sentences = [
        f"{metrics['samples']} observations on {metrics['segments']} straight segments, "
        f"{metrics['distance_driven_m']:.0f} m driven; the room's shorter side is {metrics['shorter_side_m']:.2f} m."
    ]
    if found := metrics.get("explore"):
        likely, low, high = (f"{100 * found[name]:.1f}" for name in ("unseen", "unseen_low", "unseen_high"))
        ended = "was done" if found["ended_by"] != "samples" else "ended with its last image"
        radius = "" if found["radius_m"] is None else f", radius {100 * found['radius_m']:.1f} cm"
        known = f"{likely} % of the floor unseen ({low} to {high}){radius}, after {found['driven_m']:.0f} m"
        sentences.append(f"The drive {ended}; by what the robot itself knows: {known}.")
    if distances := metrics.get("distances"):
        measured, expected = (f"{100 * distances[f'segment_{name}']:.2f} cm" for name in ("rms_m", "expected_m"))
        sentence = f"The encoders' segment lengths have an RMS error of {measured}; theory predicts {expected}."
        if wrong := distances["segments_wrong"]:
            sentence += (
                f" Of them, {wrong} have larger errors than noise explains, and on {distances['wrong_doubted']} of "
            )
            sentence += "these the wheels disagree."
        sentences.append(sentence)
    if trajectory := metrics.get("trajectory"):
        error = f"RMS {trajectory['rms_m']:.2f} m, at most {trajectory['max_m']:.2f} m"
        sentences.append(f"The dead-reckoned path, best aligned with the true one, is off by {error}.")
    stages: Mapping[str, float] = times or metrics["timing_s"]
    parts = ", ".join(f"{name} {float(value):.1f} s" for name, value in stages.items())
    return [
        *sentences,
        f"{seen} of {reachable} {places} ({100 * seen / max(reachable, 1):.1f} %) are within "
        "0.25 m of a training observation.",
        *_list_shares("Accepted images (test positions)", methods, ("accepted", "accepted_places"), 1),
        *_list_shares(
            "Accepted images within their 68 % radius (95 %)", methods, ("radius_68_holds", "radius_95_holds"), 0
        ),
        *_describe_maps(methods),
        *_describe_leans(methods),
        *_describe_deployment(metrics),
        f"Time: {parts}; {sum(stages.values()):.1f} s in all.",
    ]


def describe_errors(metrics: Mapping[str, Any]) -> str:
    """Describe in a sentence where the errors were measured and how predictions were aligned."""
    where = "at test samples of the same drive" if _is_held_out(metrics) else "on the test grid"
    worst = "" if metrics.get("test", {}).get("headings") == 1 else " for the worst heading of each position"
    return f"Errors {where}{worst}; aligned on training samples, never scaled."


def markdown_table(metrics: Mapping[str, Any], columns: Sequence[Column] = COLUMNS) -> str:
    """The methods' figures as a Markdown table."""
    return table.tabulate(*tabulate(metrics, columns))


def markdown_report(metrics: Mapping[str, Any]) -> str:
    """The complete report in Markdown: title, table, sentences about the drive, environment."""
    sentences = [*(f"- **{sentence}**" for sentence in judge_run(metrics)), *(f"- {one}" for one in describe(metrics))]
    environment = [f"- {name}: {_plain(value)}" for name, value in metrics["environment"].items()]
    title, said = f"# {metrics['scenario']}, seed {metrics['seed']}", "\n".join(sentences)
    note = f"{describe_errors(metrics)} {COLUMNS_NOTE}"
    blocks = [title, markdown_table(metrics), note, said, "## Environment", "\n".join(environment)]
    return "\n\n".join(blocks) + "\n"


def print_report(run: Path, console: Console, sitting_s: float | None = None) -> None:
    """Print a run's table and the sentences under it; raises InputError if the folder holds no run.

    ``sitting_s`` is the time since the command began, including its start-up and the time between stages.
    """
    if not (run / METRICS).is_file() and print_without_truth(run, console):
        return
    metrics = read_metrics(run)
    headings, rows = tabulate(metrics)
    title = f"{metrics['scenario']}, seed {metrics['seed']}"
    table.print_table(console, headings, rows, title, bold=title_of("deepgps"))
    console.print()
    table.say(console, f"{describe_errors(metrics)} {COLUMNS_NOTE}", *describe(metrics, stage_times(run)))
    table.say(console, *judge_run(metrics), style="yellow")
    if sitting_s is not None:
        table.say(console, f"This command took {sitting_s:.1f} s, its start included.")


def _list_shares(what: str, methods: Mapping[str, Any], keys: tuple[str, str], digits: int) -> list[str]:
    """A sentence with two shares of each method that has both; none where no method has."""
    both = {name: [values.get(key) for key in keys] for name, values in methods.items()}
    parts = [
        f"{title_of(name)} {100 * first:.{digits}f} % ({100 * second:.{digits}f} %)"
        for name, (first, second) in both.items()
        if first is not None and second is not None
    ]
    return [f"{what}: {'; '.join(parts)}."] if parts else []


def _describe_maps(methods: Mapping[str, Any]) -> list[str]:
    """Errors of the initial maps that know how good they are, beside what they expect of themselves."""
    maps = ((name, values.get("map", {})) for name, values in methods.items())
    return [
        f"The initial map of {title_of(name)} has an RMS error of {100 * found['rms_m']:.2f} cm; from its turns, "
        f"encoders and loop closures, {100 * found['expected_rms_m']:.2f} cm are expected."
        for name, found in maps
        if "rms_m" in found
    ]


def _describe_leans(methods: Mapping[str, Any]) -> list[str]:
    """How the camera leans, in training and deployment, by the first method that measures it, if it does so visibly."""
    trained = next((values for values in methods.values() if "lean_roll_deg" in values), {})
    places = {"training": trained, "deployment": trained.get("in_use", {})}
    leans = {
        where: (values["lean_roll_deg"], values["lean_pitch_deg"])
        for where, values in places.items()
        if "lean_roll_deg" in values
    }
    parts = (f"{roll:.2f}° to the right and {pitch:.2f}° forward in {where}" for where, (roll, pitch) in leans.items())
    visible = any(max(map(abs, lean)) >= MIN_LEAN_DEG for lean in leans.values())
    learned, deployed = (values.get("wobble_deg", 0.0) for values in places.values())
    more = deployed > 2.0 * learned + MIN_WOBBLE_DEG
    return [
        *([f"By its turns, the camera leans {', '.join(parts)}."] if visible else []),
        *([f"It wobbles by {deployed:.1f}°, in training by {learned:.1f}°: errors exceed the radii."] if more else []),
    ]


def _describe_deployment(metrics: Mapping[str, Any]) -> list[str]:
    """Errors on the images of a deployment drive, if any, and what the first method that tells says of it."""
    found = {name: values["in_use"] for name, values in metrics["methods"].items() if "in_use" in values}
    if not found:
        return []
    parts = (f"{title_of(name)} {_describe_deployment_errors(values)}" for name, values in found.items())
    errors = (
        f"RMS (median) on the {metrics['in_use']['samples']} images of the deployment drive [cm]: {'; '.join(parts)}."
    )
    causes = (describe_causes(values["causes"]) for values in found.values() if "causes" in values)
    return [errors, *islice(causes, 1)]


def _describe_deployment_errors(values: Mapping[str, Any]) -> str:
    of_all = f"{write_hundredths(values['rms_m'])} ({write_hundredths(values['median_m'])})"
    if values.get("rms_accepted_m") is None:
        return of_all
    accepted = f"{write_hundredths(values['rms_accepted_m'])} ({write_hundredths(values['median_accepted_m'])})"
    return f"{of_all}, of the {100 * values['accepted']:.1f} % accepted {accepted}"


def _is_held_out(metrics: Mapping[str, Any]) -> bool:
    return metrics.get("test", {}).get("held_out", False)


def _rows(name: str, values: Mapping[str, Any], columns: Sequence[Column]) -> list[Row]:
    """A method's figures; if it refuses images, also those of what it accepts."""
    rows = [(title_of(name), *fill(columns, values))]
    if values.get("accepted") is not None:
        of_accepted = [(heading, "_accepted_".join(key.rpartition("_")[::2]), form) for heading, key, form in columns]
        rows.append((f" {100 * values['accepted']:.3g} % accepted", *fill(of_accepted, values, "")))  # rms_accepted_m
    return rows


def _plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {item}" for name, item in value.items())
    return str(value)


SCALE_LIMITS = (0.9, 1.1)  # Scales of a map beyond these are no error of the encoders
MAX_RELATIVE_RMS = 0.1  # RMS, as a fraction of the room's shorter side, from which a map is of no use
MAX_TURNED_SHARE = 0.03
"""Part of the way that may be mirrored or turned in a right map: images taken for a place that looks alike. In twenty
worlds of corridors and labyrinths it was at most 1.4 % in right maps by distances alone, 4 to 55 % in wrong ones."""
MIN_SEEN_SHARE = 0.9  # Fraction of the test positions near a training observation below which the drive is too short


def judge_run(metrics: Mapping[str, Any]) -> list[str]:
    """Sentences on what is wrong with a run's results, one for all its methods and one for its drive; often none."""
    doubts = {title_of(name): find_doubts(values) for name, values in metrics["methods"].items()}
    doubtful = [f"{title} ({', '.join(reasons)})" for title, reasons in doubts.items() if reasons]
    sentences = [f"Not converged: {'; '.join(doubtful)}."] if doubtful else []
    for name, values in metrics["methods"].items():
        turned = values.get("turned", {})
        if (part := describe_turned(turned)) and turned["share"] <= MAX_TURNED_SHARE:
            sentences.append(f"{title_of(name)}: {part}.")
        if undecided := describe_undecided(values.get("map", {})):
            sentences.append(f"{title_of(name)}: {undecided}")
    if missed := describe_missed(metrics.get("coverage", {})):
        sentences.append(missed)
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
    if (reason := describe_turned(turned)) and turned["share"] > MAX_TURNED_SHARE:
        reasons.append(reason)
    if rms is not None and rms > MAX_RELATIVE_RMS:
        reasons.append(f"RMS {100 * rms:.0f} % of the room's shorter side")
    return reasons


def describe_undecided(found: Mapping[str, Any]) -> str | None:
    """Say in a sentence how much of a map is undecided, and why, by its figures; None: nothing, or there is no map."""
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
    """Say which part of a map goes another way than the compass saw, by ``find_turned_parts``; None: no part."""
    if not turned.get("parts"):
        return None
    parts = turned["parts"]
    images = f"{sum(parts)} images" if len(parts) == 1 else f"{len(parts)} parts with {sum(parts)} images"
    return f"{images}, {max(100 * turned['share'], 0.1):.1f} % of the way, are mirrored or turned by the compass"


def describe_missed(coverage: Mapping[str, Any]) -> str | None:
    """Say in a sentence how much of the room, and which part, the drive has missed; None: little."""
    reachable = coverage.get("reachable_cells", 0)
    if not reachable or coverage["cells_seen"] >= MIN_SEEN_SHARE * reachable:
        return None
    share = 100 * (1 - coverage["cells_seen"] / reachable)
    part = f", mostly in the {coverage['missed']}" if coverage.get("missed") else ""
    return f"The drive missed {share:.0f} % of the room{part}: drive more, with --drive.samples."
