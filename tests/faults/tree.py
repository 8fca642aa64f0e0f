"""A user's files: planted by chance, under names that collide with the product's own, and looked at afterwards."""

import hashlib
import os
import random
import stat
from collections.abc import Sequence
from pathlib import Path

NAMES = (
    *(
        "thesis.txt",
        "notes.123.part",
        "movie.part",
        "scenario.yaml",
        "study.yaml",
        "metrics.json",
        "run.rrd",
        "recording.rrd",
    ),
    *("recording/manifest.json", "recording/observation.npy", "recording/mine.npy", "recording.collecting/plan.txt"),
    *("deepgps/weights.safetensors", "deepgps/notes.md", "posenet/checkpoint.pt", "features/features.safetensors"),
    *(
        "figures/mine.png",
        "figures/drive.png",
        "runs/old/notes.txt",
        "recordings/tape.wav",
        "table.md",
        "table.parquet",
    ),
    *(".lock", ".deepgps", ".deepgps/config", ".mark", ".fresh", ".new/a.txt", "scenario.yaml.77.part", "log.txt"),
    *("timing.json", "error_field.npz", "truth/pose.npy", "a b c.txt", "żółć 空.txt", "-rf", "--fresh", "[bold]x.txt"),
    *("deep/er/and/deeper.txt", ".git/HEAD", "recording.12.part", "recording.old/x", "bench.json", "rooms.png"),
)
TEXTS = (
    b"",
    b"mine\n",
    b"{}\n",
    b"room: {kind: bedroom}\n",
    b"seed: 1\n",
    b"\x00\xff\xfe not text",
    b"deepgps\n",
    b'{"schema": 1}\n',
)
Looks = dict[str, str]
"""Of each file, folder and link of a user's: what it is and holds, by its path."""


def plant(folder: Path, rng: random.Random, more: Sequence[str] = (), most: int = 14) -> None:
    """Plant files, folders and links.

    Args:
        folder: Where; made if it is missing.
        rng: What decides.
        more: Names, beside the usual ones, that a file may get.
        most: Files at most.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "mine.txt").write_bytes(b"mine")
    for name in rng.sample([*NAMES, *more], rng.randint(1, most)):
        path = folder / name
        if _is_free(path, folder):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(rng.choice([*TEXTS, rng.randbytes(rng.randint(1, 5000))]))
            path.chmod(rng.choice([0o644, 0o644, 0o444, 0o600]))
    for name in rng.sample(["empty", "recording", "figures", "runs", "knn", "leer e"], 2):
        if rng.random() < 0.5 and _is_free(folder / name, folder):
            (folder / name).mkdir(parents=True)
    for number in range(rng.randint(0, 3)):
        there = [path for path in folder.rglob("*")]
        target = rng.choice([*map(str, there), "nowhere", "..", str(folder.parent / "outside"), "../outside/mine.txt"])
        path = folder / rng.choice([f"link{number}", ".lock", "recording", "metrics.json", "recording.rrd", "deepgps"])
        if _is_free(path, folder):
            path.symlink_to(target)


def look(folder: Path) -> Looks:
    """What there is in a folder."""
    found: Looks = {}
    for path in folder.rglob("*"):
        found[path.relative_to(folder).as_posix()] = _look_at(path)
    return found


def find_lost(before: Looks, folder: Path) -> list[str]:
    """What of a user's is no longer there, or no longer as it was."""
    return [f"{name} {_tell(was, folder / name)}" for name, was in before.items() if _look_at(folder / name) != was]


def _look_at(path: Path) -> str:
    try:
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode):
            return f"link to {os.readlink(path)}"
        if stat.S_ISDIR(mode):
            return "folder"
        return f"file {stat.S_IMODE(mode):o} {hashlib.sha256(path.read_bytes()).hexdigest()}"
    except (FileNotFoundError, NotADirectoryError):
        return "nothing"


def _tell(was: str, path: Path) -> str:
    return "is gone" if _look_at(path) == "nothing" else f"has changed ({was.split(maxsplit=1)[0]})"


def _is_free(path: Path, folder: Path) -> bool:
    """Whether a name can be given: nothing has it, and no file or link is where a folder must be."""
    above = [parent for parent in path.parents if parent.is_relative_to(folder)]
    plain = all(parent.is_dir() and not parent.is_symlink() for parent in above if os.path.lexists(parent))
    return plain and not os.path.lexists(path)
