"""Reading recordings back, so that code can use whatever the viewer shows."""

from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from sim.errors import InputError

ROW_ID = "rerun.controls.RowId"
COLUMNS = ("x_m", "y_m", "predicted_x_m", "predicted_y_m", "error_m", "heading_deg")


def open_rrd(path: Path) -> RrdReader:
    """Open a recording; raise InputError if the file is missing, truncated or not a recording."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with catch_warnings():
            simplefilter("ignore")  # the InputError below says the same
            reader = RrdReader(path)
            reader.store().schema()  # needs the footer, which a truncated file lacks
    except Exception as error:  # rerun raises ValueError, RuntimeError and its own types
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} is truncated or no recording ({reason}); delete it and view the run again") from None
    return reader


def read_error_table(path: Path, root: str = "world") -> pa.Table:
    """Read the error fields of all methods from a recording as one table; ``.to_pandas()`` makes a data frame of it.

    Args:
        path: A ``.rrd`` file.
        root: Entity above the error fields: ``world`` in a run's recording, ``a`` or ``b`` in the recording of a pair.

    Returns:
        A row for each method and test position, for the worst heading at that position: the true position ``x_m`` and
        ``y_m`` [m], the predicted position ``predicted_x_m`` and ``predicted_y_m`` [m], their distance ``error_m`` [m],
        the heading ``heading_deg`` [deg], and ``method``, the name in metrics.json.

    Raises:
        InputError: The file is missing, truncated, a study's recording, or has no error field below ``root``.
    """
    fields = _read_fields(path, root)
    if not fields:
        raise InputError(f"{path} has no error field below {root!r}")
    columns = dict(zip(COLUMNS, np.concatenate(list(fields.values()), axis=1), strict=True))
    return pa.table({**columns, "method": [name for name, values in fields.items() for _ in values[0]]})


def read_entity(path: Path, entity: str) -> pa.Table:
    """Read all data of one entity from a recording, in the viewer's own columns.

    Args:
        path: A ``.rrd`` file.
        entity: Path of the entity, such as ``drive/distance/encoder`` or ``world/training_error/deepgps``.

    Returns:
        A row for each time: the timelines (``drive_time`` or ``step``, and ``progress``; a study's sliders), and a
        column of lists for each component, such as ``Scalars:scalars`` or ``Arrows3D:vectors``; static data have no
        time.

    Raises:
        InputError: The file is broken or has no such entity; the message lists the entities it has.
    """
    entities, parts = set[str](), list[pa.Table]()
    for chunk in open_rrd(path).stream():
        entities.add(chunk.entity_path.lstrip("/"))
        if chunk.entity_path == f"/{entity}":
            rows = pa.table(chunk.to_record_batch()).replace_schema_metadata(None)
            parts.append(rows.drop_columns(ROW_ID))
    if not parts:
        raise InputError(f"{path} has no entity {entity!r}; it has {', '.join(sorted(entities))}")
    return pa.concat_tables(parts, promote_options="default")


def _read_fields(path: Path, root: str) -> dict[str, np.ndarray]:
    """The columns (6, n) of the error fields below an entity by method name, in the order of the file."""
    below = f"/{root}/error_field/"
    fields, moving = {}, False
    for chunk in open_rrd(path).stream():
        name = chunk.entity_path.removeprefix(below)
        if chunk.entity_path.startswith(below):
            moving |= bool(chunk.timeline_names)
            if "/" not in name:
                batch = chunk.to_record_batch()
                fields[name] = np.stack([batch.column(one).flatten().to_numpy() for one in COLUMNS])
    if moving:
        raise InputError(f"{path} has error fields of several runs; read_entity returns them with their times")
    return fields
