"""Databases of ROS 2 (.db3) as ``rosbags`` can open them.

It puts their paths into a URI as they are, where #, ? and % mean something else, and it opens them as files that never
change, without what a recorder that was killed has left in the file ``-wal`` beside. Such databases are read through
links of other names, and through copies into which the ``-wal`` file is merged. The user's files stay as they are.
"""

import re
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory

import yaml

from sim.errors import InputError
from sim.files.atomic import check_space

SUFFIXES = (".bag", ".mcap", ".db3")
SPECIAL = re.compile(r"[#?%]")
METADATA = "metadata.yaml"


def prepare_databases(path: Path, files: Sequence[Path], stack: ExitStack) -> tuple[Path, list[Path]]:
    """Paths of a log and of its storage files under which ``rosbags`` reads all that its databases hold.

    Args:
        path: The log, a file or a folder.
        files: Its storage files that are not compressed.
        stack: Removes links and copies when it is closed.

    Raises:
        InputError: A database and its ``-wal`` file are damaged.
        WorkError: There is no space for the copy.
    """
    stored = [path] if path.is_file() else [one for one in path.iterdir() if not {*SUFFIXES}.isdisjoint(one.suffixes)]
    databases = [one for one in stored if ".db3" in one.suffixes]
    if not any(_has_wal(one) or SPECIAL.search(str(one.absolute())) for one in databases):
        return path, list(files)
    place = Path(stack.enter_context(TemporaryDirectory(prefix="deepgps-log-")))
    for one in stored:
        if one in databases and _has_wal(one):
            _merge(one, place / _rename(one.name))
        else:
            (place / _rename(one.name)).symlink_to(one.absolute())
    if (path / METADATA).is_file():
        _copy_metadata(path / METADATA, place / METADATA)
    return place if path.is_dir() else place / _rename(path.name), [place / _rename(one.name) for one in files]


def _rename(name: str) -> str:
    """A name without characters that are special in a URI."""
    return SPECIAL.sub(lambda found: f"={ord(found[0])}=", name)


def _wal(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")


def _has_wal(file: Path) -> bool:
    """Whether messages are in the ``-wal`` file of a database."""
    return _wal(file).is_file() and _wal(file).stat().st_size > 0


def _merge(file: Path, copy: Path) -> None:
    """Copy a database with all messages, also those of its ``-wal`` file."""
    check_space(copy, file.stat().st_size + 2 * _wal(file).stat().st_size)
    shutil.copyfile(file, copy)
    shutil.copyfile(_wal(file), _wal(copy))
    try:
        with closing(sqlite3.connect(copy)) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            database.execute("PRAGMA journal_mode=DELETE")
    except sqlite3.DatabaseError as error:
        raise InputError(f"{_wal(file)} does not fit {file.name} ({error}); move it away to read the rest") from None


def _copy_metadata(file: Path, copy: Path) -> None:
    """Copy the metadata of a log whose files have other names."""
    values = yaml.safe_load(file.read_text())
    about = values["rosbag2_bagfile_information"]
    about["relative_file_paths"] = [_rename(PurePath(name).name) for name in about["relative_file_paths"]]
    copy.write_text(yaml.safe_dump(values, sort_keys=False))
