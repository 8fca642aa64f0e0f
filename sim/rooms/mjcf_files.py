"""The files of a user's own room or robot, after a trial in a process with limits.

The trial is this file, run as a program: nothing in a room can hang or fill the machine, and only a file that has
passed is read by the caller. A machine without MuJoCo can list the files, since it compiles none.
"""

import json
import os
import resource
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

import numpy as np

from sim.errors import InputError, one_line, read_file, shorten

if TYPE_CHECKING:
    import mujoco

Kind = Literal["room", "robot"]
CPU_S, TRIAL_S = 10, 60.0  # Time that a trial may compute, and that it may take on a busy machine [s]
MEMORY_BYTES = 2 * 1024**3
MAX_COORDINATE_M = 1e10  # Largest coordinate and size of a geom [m]
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_REFUSALS = {"plugin": "plugins", "extension": "extensions", "flex": "flexible bodies", "flexcomp": "flexible bodies"}


def list_files(path: Path, kind: Kind = "room") -> list[Path]:
    """The files that a room or a robot uses, its own first, after MuJoCo has compiled it within the limits.

    Raises InputError if it is refused; one line names the setting, the file and the reason.
    """
    what = f"{kind}.mjcf {shorten(str(path), 300)}"
    content = read_file(path, MEMORY_BYTES, what)
    result = json.loads(_try_out(str(path.resolve()), kind, content))
    if "refused" in result:
        raise InputError(f"{what}: {shorten(result['refused'], 500)}")
    return [Path(file) for file in result["files"]]


def read_model(path: Path, kind: Kind) -> "tuple[mujoco.MjSpec, mujoco.MjModel]":
    """Read a room or a robot that has passed its trial, without what the testbed does not use; raises InputError."""
    list_files(path, kind)
    try:
        return _compile(path.resolve(), kind)
    except InputError as error:
        raise InputError(f"{kind}.mjcf {shorten(str(path), 300)}: {error}") from None


@lru_cache(maxsize=8)
def _try_out(path: str, kind: Kind, content: bytes) -> str:
    command = [sys.executable, "-P", "-m", "sim.rooms.mjcf_files", kind, path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)), "OMP_NUM_THREADS": "1"}
    with TemporaryDirectory() as folder:
        try:
            done = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, text=True, timeout=TRIAL_S, check=True
            )
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
            reason = "MuJoCo cannot compile it within 10 s of computing and 2 GB of memory"
            return json.dumps({"refused": reason})
    return done.stdout


def find_files(path: Path, kind: Kind) -> list[Path]:
    """The files that an MJCF file uses, itself first; raises InputError if one is outside its folder."""
    roots, queue = dict[Path, ET.Element](), [path]
    while queue:
        file = queue.pop()
        if file in roots:
            continue
        root = roots[file] = _parse(file)
        for element in root.iter():
            if element.tag in _REFUSALS:
                raise InputError(f"{_REFUSALS[element.tag]} are not allowed (<{element.tag}>)")
            if element.tag in {"include", "model"} and "file" in element.attrib:
                queue += _find(element, "file", path.parent, {path.parent, file.parent})
    if roots[path].tag != "mujoco":
        raise InputError(f"not an MJCF file: its root is <{roots[path].tag}>, and must be <mujoco>")
    if kind == "robot":  # whose meshes and textures nobody reads
        return [path, *sorted(set(roots) - {path})]
    elements = [element for root in roots.values() for element in root.iter()]
    folders = {file.parent for file in roots}
    for element in elements:
        for key in _FOLDERS if element.tag == "compiler" else ():
            _refuse_outside(element, key)
            folders |= {file.parent / element.get(key, "") for file in roots}
    used = set(roots)
    for element in elements:
        for name in element.attrib:
            if name.startswith("file"):
                used.update(_find(element, name, path.parent, folders))
    return [path, *sorted(used - {path})]


def _parse(path: Path) -> ET.Element:
    try:
        text = path.read_bytes().decode("utf-8-sig")
        # Entities could name other files, and MuJoCo, which has no namespaces, would read other elements than we do.
        if "<!DOCTYPE" in text or "<!ENTITY" in text or "xmlns" in text:
            raise InputError(f"a DOCTYPE, an entity or a namespace is not allowed in {path.name}")
        return ET.fromstring(text.encode(), ET.XMLParser(encoding="utf-8"))
    except UnicodeDecodeError:
        raise InputError(f"{path.name} is not UTF-8 text") from None
    except ET.ParseError as error:
        raise InputError(f"not XML: {error} in {path.name}") from None


def _find(element: ET.Element, name: str, root: Path, folders: Iterable[Path]) -> Iterator[Path]:
    """The existing files that an attribute can mean, all of them in the folder ``root``."""
    value = _refuse_outside(element, name)
    # Which folder MuJoCo uses depends on the last file that sets one; with strippath it uses the last part alone.
    for place in {folder / part for folder in folders for part in (value, Path(value).name)}:
        file = place.resolve()
        if file.is_file() and not file.is_relative_to(root):
            raise InputError(f"{element.tag} {name} {value}: lies outside its own folder")
        if file.exists() and not file.is_file() and not file.is_dir():
            raise InputError(f"{element.tag} {name} {value} is a pipe or a device")
        if file.is_file():
            yield file


def _refuse_outside(element: ET.Element, name: str) -> str:
    value = element.get(name, "")
    if Path(value).is_absolute() or ".." in Path(value).parts or "\\" in value or ":" in value:
        raise InputError(f"{element.tag} {name} {value}: must be a path within its own folder")
    return value


def try_out(path: Path, kind: Kind) -> list[Path]:
    """Read an MJCF file and, if there is MuJoCo, compile it; return the files that it uses, itself first.

    Raises InputError if it is no MJCF file, names a file outside its own folder, or MuJoCo cannot compile it.
    """
    files = find_files(path, kind)
    try:
        import mujoco
    except ModuleNotFoundError:
        return files
    mujoco.set_mju_user_warning(lambda text: None)
    _, model = _compile(path, kind)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for values in (data.geom_xpos, data.geom_xmat, model.geom_size):
        if not (np.abs(values) < MAX_COORDINATE_M).all():
            raise InputError("a geom is infinitely large or far away")
    return files


def _compile(path: Path, kind: Kind) -> "tuple[mujoco.MjSpec, mujoco.MjModel]":
    import mujoco

    from sim.rooms.spec import make_static, strip_robot

    try:
        spec = mujoco.MjSpec.from_file(str(path))
        (make_static if kind == "room" else strip_robot)(spec)
        return spec, spec.compile()
    except InputError:
        raise
    except (ValueError, RuntimeError, MemoryError, mujoco.FatalError) as error:
        raise InputError(f"MuJoCo cannot read it: {shorten(one_line(error), 400)}") from None


def main(kind: Kind, path: Path) -> None:
    """Print the files, or the reason why the file is refused, as JSON."""
    for limit, most in ((resource.RLIMIT_CPU, CPU_S), (resource.RLIMIT_DATA, MEMORY_BYTES), (resource.RLIMIT_CORE, 0)):
        resource.setrlimit(limit, (most, resource.getrlimit(limit)[1]))
    try:
        print(json.dumps({"files": [str(file) for file in try_out(path, kind)]}))
    except InputError as error:
        print(json.dumps({"refused": str(error)}))


if __name__ == "__main__":
    main("room" if sys.argv[1] == "room" else "robot", Path(sys.argv[2]))
