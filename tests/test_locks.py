"""The locks hold exactly what pyproject.toml asks for: what running needs in one, the rest in the other."""

import re
import tomllib
from collections.abc import Iterable
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = SETTINGS["project"]
EXTRAS = PROJECT["optional-dependencies"]
LEFT_TO_TORCH = re.compile(r"nvidia-|cuda-|triton")  # the CUDA build's own packages, at versions that it pins


def read_lock(name: str) -> list[str]:
    """Return the requirements that a lock lists, without those of a lock that it includes."""
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith(("#", "-r "))]


def pins_here(lock: Iterable[str]) -> dict[str, str]:
    """Return the version that a lock pins of each package that it installs in this Python."""
    pinned = [Requirement(line) for line in lock]
    return {
        canonicalize_name(one.name): str(one.specifier).removeprefix("==")
        for one in pinned
        if one.marker is None or one.marker.evaluate()
    }


def needed_by(lines: Iterable[str]) -> dict[str, list[Requirement]]:
    """Return each package that these requirements need, directly or not, with all that is required of it.

    The needs of this project are read from pyproject.toml, those of others from what is installed.
    """
    found: dict[str, list[Requirement]] = {}
    todo = [(Requirement(line), "") for line in lines]
    while todo:
        one, within = todo.pop()
        name = canonicalize_name(one.name)
        if one.marker is not None and not one.marker.evaluate({"extra": within}):
            continue
        if LEFT_TO_TORCH.match(name) or one in found.setdefault(name, []):
            continue
        found[name].append(one)
        for extra in one.extras | {""}:
            needs = EXTRAS.get(extra, []) if name == PROJECT["name"] else requires(name) or []
            todo += [(Requirement(line), extra) for line in needs]
    found.pop(PROJECT["name"], None)
    return found


RUNNING_LOCK, DEV_LOCK = read_lock("requirements.lock"), read_lock("requirements-dev.lock")
RUNNING_NEEDS = needed_by(PROJECT["dependencies"] + SETTINGS["build-system"]["requires"])
DEV_NEEDS = needed_by(EXTRAS["dev"])


def test_one_lock_holds_what_running_and_installing_need_and_nothing_else():
    assert set(pins_here(RUNNING_LOCK)) == set(RUNNING_NEEDS)


def test_the_other_lock_holds_the_rest():
    assert set(pins_here(DEV_LOCK)) == set(DEV_NEEDS) - set(RUNNING_NEEDS)
    assert "\n-r requirements.lock\n" in (ROOT / "requirements-dev.lock").read_text(encoding="utf-8")


def test_all_extras_are_in_the_second_lock():
    assert set(needed_by(line for extra in EXTRAS.values() for line in extra)) == set(DEV_NEEDS)


@pytest.mark.parametrize("needs", [RUNNING_NEEDS, DEV_NEEDS], ids=["running", "dev"])
def test_every_package_accepts_the_locked_versions_of_its_needs(needs):
    pins = pins_here(RUNNING_LOCK + DEV_LOCK)
    for name, wanted in needs.items():
        for one in wanted:
            assert one.specifier.contains(pins[name], prereleases=True), f"{one}, but {pins[name]} is locked"


@pytest.mark.parametrize("line", RUNNING_LOCK + DEV_LOCK)
def test_every_line_pins_one_version(line):
    assert re.fullmatch(r'[a-z0-9-]+==[\w.]+(; python_version < "3\.1[34]")?', line)
