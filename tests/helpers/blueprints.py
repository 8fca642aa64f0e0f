"""The layout in a recording, for tests of what its views show, and whether a recording is whole."""

import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
from rerun.chunk import RrdReader

from deepgps.evaluation.error_field import WorstField
from deepgps.viewer.connect import find_viewer
from deepgps.viewer.read import COLUMNS, read_error_table

OVERRIDES = "/ViewContents/overrides/"


def count_rows(path: Path) -> Counter[str]:
    """Rows of each entity of a recording along its timelines; what is static counts none."""
    counts = Counter[str]()
    for chunk in RrdReader(path).stream():
        counts[chunk.entity_path] += chunk.num_rows if chunk.timeline_names else 0
    return counts


def read_error_field(path: Path, method: str, root: str = "world") -> WorstField:
    """A method's error field in a recording."""
    rows = read_error_table(path, root).filter(pc.field("method") == method)
    columns = (rows[name].to_numpy() for name in COLUMNS)
    x, y, *predicted, error, heading = columns
    return WorstField(np.stack([x, y], axis=1), np.stack(predicted, axis=1), error, np.radians(heading))


def find_missing(path: Path) -> list[str]:
    """What the views of a recording show that was not logged: paths, with all below them where they end in ``/**``."""
    named = set(find_shown(path))
    assert named
    logged = {chunk.entity_path.strip("/") for chunk in RrdReader(path).stream()}
    return sorted(shown for shown in named if not any(is_shown(entity, shown) for entity in logged))


def find_shown(path: Path) -> Iterator[str]:
    """Every path that a view of a recording names."""
    for entity, origins in read_layout(path, "ViewBlueprint:space_origin"):
        assert entity.startswith("/view/")
        yield from (f"{origin.strip('/')}/**" for origin in origins)
    for _, paths in read_layout(path, "ViewContents:query"):
        yield from (shown for shown in paths if not shown.startswith("$origin"))
    for entity, _ in read_layout(path, "VisibleTimeRanges:ranges"):
        if OVERRIDES in entity:
            yield entity.partition(OVERRIDES)[2].removesuffix("/visualizers")


def read_layout(path: Path, component: str) -> Iterator[tuple[str, list]]:
    """A component of the layout anywhere in it."""
    reader = RrdReader(path)
    for layout in reader.blueprints():
        for chunk in reader.stream(store=layout):
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                yield chunk.entity_path, [one for row in batch.column(component).to_pylist() for one in row]


def is_shown(entity: str, shown: str) -> bool:
    """Whether a path of a view takes in an entity."""
    root = shown.removesuffix("/**")
    return entity == shown or (shown.endswith("/**") and f"{entity}/".startswith(f"{root}/".lstrip("/")))


def call_rerun(*words: str | Path) -> None:
    """Let Rerun's own program verify or compare recordings; what is wrong is an AssertionError."""
    command = [find_viewer(), "rrd", *map(str, words)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
