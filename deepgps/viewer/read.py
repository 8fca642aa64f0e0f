"""Reading recordings back: whatever the viewer shows is there for code."""

from pathlib import Path
from warnings import catch_warnings, simplefilter

import numpy as np
from rerun.chunk import RrdReader

from deepgps.figures import WorstField
from sim.errors import InputError

FIELDS = "/world/error_field/"


def open_rrd(path: Path) -> RrdReader:
    """Open a recording; raises InputError where it is missing, cut off or something else."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with catch_warnings():
            simplefilter("ignore")  # what it warns of is told below
            reader = RrdReader(path)
            reader.store().schema()  # needs the footer, which a cut-off file lacks
    except Exception as error:  # rerun raises ValueError, RuntimeError and its own kinds
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} is cut off or no recording ({reason}); delete it and view the run again") from None
    return reader


def read_error_field(path: Path, method: str) -> WorstField:
    """Read a method's error field back from a recording.

    Args:
        path: A ``.rrd`` file.
        method: Its name, as in metrics.json.

    Raises:
        InputError: The file is broken, or has no such method; the names it has are told.
    """
    columns: dict[str, np.ndarray] = {}
    methods: set[str] = set()
    for chunk in open_rrd(path).stream():
        if chunk.entity_path.startswith(FIELDS):
            methods.add(chunk.entity_path.removeprefix(FIELDS).split("/")[0])
        if chunk.entity_path == FIELDS + method:
            batch = chunk.to_record_batch()
            for name in {"Arrows3D:origins", "Arrows3D:vectors"} & set(batch.schema.names):
                flat = batch.column(name).flatten().flatten().to_numpy()
                columns[name] = flat.reshape(-1, 3)[:, :2].astype(float)
    if method not in methods:
        raise InputError(f"{path} has no method {method!r}; it has {', '.join(sorted(methods)) or 'none'}")
    truth, error = columns["Arrows3D:origins"], columns["Arrows3D:vectors"]
    return WorstField(truth, truth + error, np.linalg.norm(error, axis=1))
