"""Compare two folders of runs or studies, made by two versions of the code: every array, weight and figure.

    python tests/same_bytes.py OLD NEW

Compared are all .npy and .npz arrays (also of recordings), .safetensors weights, .parquet tables, and every value of
JSON files but seconds and the environment. Folders of a study's runs are named by hashes of all settings, so the runs
of two studies are paired by the rows of their tables. Exit 0: all the same. Else one line for each difference.
"""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from safetensors.numpy import load_file

UNCOMPARED_KEYS = {
    "environment",
    "timing_s",
    "train_s",
    "trained_on",
    "packages",
    "gl_renderer",
    "git",
    "seconds",
    "checksum",
    "schema",
    "format",
    "run",
    "recording",
}
"""Keys of JSON files and columns of tables: seconds, checksums (of seconds too), the machine, packages, hashes."""
UNCOMPARED_FILES = {"timing.json", "inputs.json", "complete.json", "manifest.json"}
"""A manifest lists settings, of which there are fewer in format 2; the recording's arrays are compared."""
SUFFIXES = {".npy", ".npz", ".safetensors", ".parquet", ".json"}


def read(path: Path) -> dict[str, Any]:
    """Contents of a file by name: arrays, columns, or the values of a JSON file by dotted key."""
    if path.suffix == ".npy":
        return {"": np.load(path, mmap_mode="r")}
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return dict(arrays)
    if path.suffix == ".safetensors":
        return load_file(path)
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        return {name: table[name].to_pylist() for name in table.column_names if name not in UNCOMPARED_KEYS}
    return dict(flatten(json.loads(path.read_text())))


def flatten(value: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested mappings and lists by dotted key, without those that may differ."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in UNCOMPARED_KEYS and not key.endswith("_s") and "sha256" not in key and key != "files":
                yield from flatten(inner, f"{before}.{key}" if before else key)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            yield from flatten(inner, f"{before}[{place}]")
    else:
        yield before, value


def is_same(one: Any, other: Any) -> bool:
    """Whether two values agree in every byte; NaN is NaN."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    return one == other or repr(one) == repr(other)


def list_files(folder: Path) -> dict[str, Path]:
    """The compared files below a folder by relative path; links to recordings are followed.

    The runs of a study are named by their place in its table; its shared recordings and trainings are theirs too.
    """
    if not (folder / "table.parquet").is_file():
        return _walk(folder)
    runs = dict.fromkeys(pq.read_table(folder / "table.parquet")["run"].to_pylist())
    found = {"table.parquet": folder / "table.parquet"}
    for place, run in enumerate(runs):
        found |= {f"run {place}: {name}": path for name, path in _walk(folder / "runs" / run).items()}
    return found


def _walk(folder: Path) -> dict[str, Path]:
    paths = (Path(home) / name for home, _, names in os.walk(folder, followlinks=True) for name in names)
    return {
        str(path.relative_to(folder)): path
        for path in paths
        if path.suffix in SUFFIXES and path.name not in UNCOMPARED_FILES
    }


def compare(old: Path, new: Path) -> tuple[int, list[str]]:
    """Number of compared values, and a line for each difference."""
    before, after = list_files(old), list_files(new)
    lines = [f"{name}: only in {old}" for name in sorted(before.keys() - after.keys())]
    lines += [f"{name}: only in {new}" for name in sorted(after.keys() - before.keys())]
    count = 0
    for name in sorted(before.keys() & after.keys()):
        one, other = read(before[name]), read(after[name])
        lines += [f"{name} {key}: only in one" for key in sorted(one.keys() ^ other.keys())]
        for key in sorted(one.keys() & other.keys()):
            count += 1
            if not is_same(one[key], other[key]):
                lines.append(f"{name} {key}: differs")
    return count, lines


if __name__ == "__main__":
    values, differences = compare(Path(sys.argv[1]), Path(sys.argv[2]))
    print(*differences, sep="\n", end="\n" if differences else "")
    print(f"{values} values compared, {len(differences)} differ")
    sys.exit(bool(differences))
