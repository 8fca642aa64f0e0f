"""The texts of a study's recording: where a slider is, and what each slider does."""

from collections.abc import Sequence

from deepgps.config.methods import title_of
from deepgps.reports.table import tabulate
from deepgps.studies.study import Study
from deepgps.studies.table import Row, split_by
from deepgps.viewer.study.sliders import RUN, Slider, Step

SHOWN = {"rms_m": "RMS", "median_m": "median", "p95_m": "p95", "max_m": "max"}
MOST_VALUES = 8


def describe_field(method: str, slider: Slider, step: Step) -> str:
    """The lines above a method's error field."""
    where = step.value if slider.name == RUN else f"{slider.name} {step.value}"
    row = next((row for row in step.rows if row["method"] == method), None)
    if row is None:
        return f"{where}\nno {title_of(method)}"
    if row["failure"] is not None:
        return f"{where}\nfailed"
    return f"{where}\nRMS {write_length(row['rms_m'])}, median {write_length(row['median_m'])}"


def describe_step(slider: Slider, step: Step) -> str:
    """Describe a slider's place in Markdown: which run is shown, its errors, and the RMS over all seeds."""
    row = step.rows[0]
    blocks = [f"# {slider.name} {step.value}" if slider.name != RUN else f"# {step.value}"]
    if row["failure"] is not None:
        return "\n\n".join([*blocks, f"This run failed: {row['failure']}"])
    blocks.append(f"Run `{row['run']}`: {step.words}.")
    cells = [[title_of(one["method"]), *(write_length(one[name]) for name in SHOWN)] for one in step.rows]
    blocks.append(tabulate(["method", *SHOWN.values()], cells))
    seeds = len({one["run"] for one in step.repeats})
    if seeds > 1:
        ranges = [
            f"{title_of(name)} {_range([one['rms_m'] for one in group])}"
            for name, group in split_by(step.repeats, "method").items()
        ]
        blocks.append(f"RMS of all {seeds} seeds: {'; '.join(ranges)}.")
    return "\n\n".join(blocks)


def describe_study(
    study: Study, rows: Sequence[Row], sliders: Sequence[Slider], left_out: Sequence[str], every: int
) -> str:
    """Describe in Markdown what each slider does, and how to read an error field."""
    runs = split_by(rows, "run")
    lines = [f"- **{slider.name}**: {_list_values(slider)}" for slider in sliders]
    first = f"The slider at the bottom moves `{sliders[0].name}`"
    more = "; the list to its left has the others." if len(sliders) > 1 else "."
    reading = (
        "Each arrow points from a true test position to the predicted position, for the worst heading there. All "
        "methods and all positions of a slider share one colour scale. Every room is scaled to fill the same "
        "rectangle; the bar above it shows its scale. Point at an arrow or a dot: error, heading → predicted x, y [m]. "
        "The numbers on a slider are the setting's values, in the unit in brackets after its name."
    )
    notes = [f"Left out because it has too many positions: {name}." for name in left_out]
    notes += [f"Only one in {every} test positions is drawn, to keep the file small."] if every > 1 else []
    return "\n\n".join(
        [f"# {study.name}: {len(runs)} runs of {study.scenario}", first + more, "\n".join(lines), reading, *notes]
    )


def write_length(length_m: float) -> str:
    """Write a length in a suitable unit; less than a micrometre counts as zero."""
    if length_m < 1e-6:
        return "0 mm"
    if length_m < 0.01:
        return f"{1000 * length_m:.2f} mm"
    return f"{100 * length_m:.1f} cm" if length_m < 1 else f"{length_m:.2f} m"


def _list_values(slider: Slider) -> str:
    if slider.name == RUN:
        return f"all {len(slider.steps)} runs, one after another"
    values = [f"`{step.value}`" for step in slider.steps]
    if len(values) > MOST_VALUES:
        values = [*values[: MOST_VALUES - 2], "...", values[-1]]
    count = f"{len(slider.steps)} positions, " if "..." in values else ""
    others = f" (with {slider.others})" if slider.others else ""
    return f"{count}{', '.join(values)}{others}"


def _range(values: Sequence[float]) -> str:
    return f"{write_length(min(values))} to {write_length(max(values))}"
