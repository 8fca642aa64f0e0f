"""The layout in a recording, for tests of what its views show, and whether a recording is whole."""

import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from deepgps.viewer.connect import find_viewer
from deepgps.viewer.error_field import ACCEPTED_PART, REFUSED_PART

OVERRIDES = "/ViewContents/overrides/"


def count_rows(path: Path) -> Counter[str]:
    """Rows of each entity of a recording along its timelines; what is static counts none."""
    counts = Counter[str]()
    for chunk in RrdReader(path).stream():
        counts[chunk.entity_path] += chunk.num_rows if chunk.timeline_names else 0
    return counts


def read_entity(path: Path, entity: str) -> pa.Table:
    """All data of one entity of a recording, in the viewer's own columns; empty if there is no such entity."""
    chunks = [chunk for chunk in RrdReader(path).stream() if chunk.entity_path == f"/{entity}"]
    parts = [pa.table(chunk.to_record_batch()).replace_schema_metadata(None) for chunk in chunks]
    return pa.concat_tables([part.drop_columns("rerun.controls.RowId") for part in parts], promote_options="default")


def read_static(path: Path, entity: str, component: str) -> list:
    """All values of a component of a static entity."""
    return read_entity(path, entity)[component].combine_chunks().flatten().to_pylist()


def read_error_field(
    path: Path, method: str, root: str = "world", parts: tuple[str, ...] = (ACCEPTED_PART, REFUSED_PART)
) -> tuple[np.ndarray, np.ndarray]:
    """Where a method's arrows of these parts begin and end in a recording (n, 2) [m]."""
    strips = [read_static(path, f"{root}/error_field/{method}/{part}/arrows", "LineStrips3D:strips") for part in parts]
    points = np.array([strip for some in strips for strip in some]).reshape(-1, 5, 3)
    return points[:, 0, :2], points[:, 1, :2]


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
