"""Disk: it fills up or is read-only, in every stage; with room again come the same bytes."""

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

from tests.faults.attack import Case, Result, Test, Verdict, skip
from tests.faults.command import Ended, deepgps
from tests.faults.fingerprint import Print, differences, take
from tests.faults.material import Material, Run, copy

STAGES = {"nothing": "collect", "collected": "train", "trained": "evaluate", "evaluated": "run"}
"""How far the run is, and the command that must write more; the last one draws and shows."""
AFTER = {"nothing": "collected", "collected": "trained", "trained": "evaluated", "evaluated": "finished"}
PAGE = 4096
ROOM_MB = 400
SIZES = re.compile(r"\d[\d.,]*\s*([kKMG]i?B|bytes?)\b")


def list_tests(material: Material) -> list[Test | Result]:
    """Each stage on a disk that is too small, and on one that is read-only."""
    run = material.runs["room"]
    if os.geteuid() != 0 or not _can_mount():
        return [skip("disk", "a full disk, a read-only one", "needs root, to mount a file system of its own")]
    return [
        *(Test("disk", f"full, {stage}, then {word}", 3, _attack_full(run, stage)) for stage, word in STAGES.items()),
        Test("disk", "full, --fresh over a finished run", 2, _attack_fresh(run)),
        Test("disk", "read-only", 2, _attack_read_only(run), of=len(STAGES)),
    ]


def _attack_full(run: Run, stage: str) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        need = _size(run.stages[AFTER[stage]]) - (_size(run.stages[stage]) if stage in run.stages else 0)
        share = case.rng.choice([0.0, case.rng.uniform(0.0, 0.2), case.rng.uniform(0.0, 1.0)])
        with mounted(case.folder / "disk") as disk:
            _put(run, stage, disk / "run")
            disk.resize(_size_of_use(disk.path) + round(need * share / PAGE) * PAGE)
            return _fill_and_go_on(run, STAGES[stage], disk, f"{share:.3f} of the {need} bytes wanted were free")

    return attempt


def _attack_fresh(run: Run) -> Callable[[Case], Verdict]:
    """The old run is whole afterwards, or at once."""

    def attempt(case: Case) -> Verdict:
        need = _size(run.stages["finished"])
        share = case.rng.uniform(0.0, 0.9)
        with mounted(case.folder / "disk") as disk:
            folder = _put(run, "finished", disk / "run")
            disk.resize(_size_of_use(disk.path) + round(need * share / PAGE) * PAGE)
            ended = _give(run, "run", case.folder, "--fresh")
            if wrong := differences(run.clean, take(folder)):
                return Verdict("old run lost", False, f"{len(wrong)} differ, as {wrong[0]}; {ended.show()}")
            if fault := judge_line(ended, case.folder):
                return Verdict(fault, False, f"{share:.3f} of {need} bytes were free: {ended.show()}")
            disk.resize(ROOM_MB << 20)
            return _go_on(_give(run, "run", case.folder, "--fresh"), run, "run", folder)

    return attempt


def _attack_read_only(run: Run) -> Callable[[Case], Verdict]:
    def attempt(case: Case) -> Verdict:
        stage = list(STAGES)[case.number % len(STAGES)]
        with mounted(case.folder / "disk") as disk:
            folder = _put(run, stage, disk / "run")
            disk.remount("ro")
            ended = _give(run, STAGES[stage], case.folder)
            fault = judge_line(ended, case.folder, sizes=False)
            if fault or ended.code == 0:
                return Verdict(fault or "done on a read-only disk", False, ended.show())
            disk.remount("rw")
            return _go_on(_give(run, STAGES[stage], case.folder), run, STAGES[stage], folder)

    return attempt


def judge_line(ended: Ended, folder: Path, sizes: bool = True) -> str:
    """What is wrong with how a command ended that had too little room: empty where it is one good line, or all is done.

    Args:
        ended: The command.
        folder: Above the place that is too small: the line must name that place, or a file in it.
        sizes: Whether the line must say what was needed and what was free.
    """
    if ended.fell or ended.code == 0:
        return ended.fell
    if len(ended.problems) != 1 or len(ended.complaints) != 1:
        return f"{len(ended.complaints)} lines"
    line = ended.problems[0]
    if str(folder) not in line and "disk/run" not in line:
        return "a line without the path"
    if sizes and not ("free" in line and len(SIZES.findall(line)) > 1):
        return "a line without what is needed and free"
    return "" if ended.code == 1 or not sizes else f"one line, but exit {ended.code}"


def _fill_and_go_on(run: Run, command: str, disk: "Disk", how: str) -> Verdict:
    folder = disk.path.parent
    ended = _give(run, command, folder)
    if fault := judge_line(ended, folder):
        return Verdict(fault, False, f"{how}: {ended.show()}")
    disk.resize(ROOM_MB << 20)
    again = _give(run, command, folder) if ended.code else ended
    verdict = _go_on(again, run, command, disk / "run")
    return verdict if ended.code or not verdict.held else Verdict("there was room enough", True)


def _go_on(again: Ended, run: Run, command: str, folder: Path) -> Verdict:
    """Judge the same command, given again with room."""
    if again.fell or again.code:
        return Verdict("does not go on", False, again.show())
    if wrong := differences(_expect(run, command), take(folder)):
        return Verdict("another result", False, f"{', '.join(wrong[:5])}: {again.show()}")
    if parts := list(folder.rglob("*.part")):
        return Verdict("left a .part file", False, f"{parts[0]}: {again.show()}")
    return Verdict("one line, then the same bytes", True)


def _expect(run: Run, command: str) -> Print:
    """What a run holds after a command, of what it holds in the end."""
    if command in {"run", "evaluate"}:
        return run.after(command)
    parts = ("recording/",) if command == "collect" else ("recording/", "deepgps/", "posenet/", "knn/")
    found = {name: value for name, value in run.clean.items() if name.startswith(parts)}
    return {name: value for name, value in found.items() if "/alignment.json" not in name}  # which evaluation writes


def _give(run: Run, command: str, folder: Path, *more: str) -> Ended:
    return deepgps(command, run.source, "--out", "disk/run", *more, cwd=folder)


def _put(run: Run, stage: str, folder: Path) -> Path:
    if stage in run.stages:
        return copy(run.stages[stage], folder)
    folder.mkdir()
    return folder


def _size(folder: Path) -> int:
    """Bytes that a folder takes on a disk of whole pages."""
    return sum(-(-path.stat().st_size // PAGE) * PAGE for path in folder.rglob("*") if path.is_file())


def _size_of_use(path: Path) -> int:
    found = os.statvfs(path)
    return (found.f_blocks - found.f_bfree) * found.f_frsize


class Disk:
    """A file system of one's own, in memory, mounted at a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __truediv__(self, name: str) -> Path:
        return self.path / name

    def resize(self, size: int) -> None:
        """Give it so many bytes, a page at least, since none would mean no limit."""
        self.remount(f"size={max(size, PAGE)}")

    def remount(self, options: str) -> None:
        """Change its options."""
        subprocess.run(["mount", "-o", f"remount,{options}", str(self.path)], check=True)


@contextmanager
def mounted(path: Path, options: str = "nr_inodes=100000") -> Iterator[Disk]:
    """Mount one; gone when left."""
    path.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={ROOM_MB}m,{options}", "faults", str(path)], check=True)
    try:
        yield Disk(path)
    finally:
        subprocess.run(["umount", "-l", str(path)], check=True)


def _can_mount() -> bool:
    try:
        with mounted(Path(mkdtemp()) / "try"):
            return True
    except (OSError, subprocess.CalledProcessError):
        return False
