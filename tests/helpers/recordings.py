"""What tests of recordings share: changed settings, files by their paths, and parts drawn in the test's own process."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import pytest

from sim.recording import chunks
from sim.recording import collect as collecting
from sim.recording.derive import IMAGE_COUNTS
from sim.recording.format import DEPLOYMENT_MANIFEST, read_manifest
from sim.recording.renderers import Draw, Part
from sim.settings import SimSettings

MAKING = {"collect_s", "derived_from", "samples_dropped", "times_relocated", "renderer_deaths", *IMAGE_COUNTS}
"""Entries of a manifest that tell of the making."""


def quiet(*_: object) -> None:
    """Report nothing."""


def change(settings: SimSettings, **groups: object) -> SimSettings:
    """The settings with some fields of some groups changed, or with other values that are no groups."""
    values = settings.model_dump()
    changes = {name: values[name] | group if isinstance(group, dict) else group for name, group in groups.items()}
    return SimSettings.model_validate(values | changes)


def read_files(folder: Path) -> dict[str, bytes]:
    """All files but the manifests, by their paths in the recording."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "manifest.json")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def read_what_must_agree(folder: Path) -> dict:
    """The manifest without what tells of the making."""
    manifest = read_manifest(folder).model_dump(exclude=MAKING)
    manifest["sha256"].pop(DEPLOYMENT_MANIFEST, None)  # which tells of the making, too
    return manifest


class DrawnHere:
    """Draws each part at once, so that no process has to import MuJoCo and build the room first."""

    deaths = drawn = 0

    def __init__(self, draw: Draw, count: int, longest_s: float) -> None:
        self._draw = draw

    def give(self, part: Part) -> None:
        self._draw(part, lambda: None)
        self.drawn += 1

    def finish(self, progress: Callable[[int], None]) -> None:
        progress(self.drawn)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


@contextmanager
def small_chunks(size: int = 32) -> Iterator[None]:
    """Chunks so small that a short drive has several, drawn in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collecting, "CHUNK", size)
        patch.setattr(chunks, "CHUNK", size)
        patch.setattr(collecting, "Renderers", DrawnHere)
        yield
