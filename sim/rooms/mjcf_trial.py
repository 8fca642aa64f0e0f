"""A trial of a user's own room or robot, run as a process of its own: which files it uses, or why it is refused.

The process has limits, so that nothing in a file can hang or fill the machine. Only then does the caller read the file.
"""

import json
import resource
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from pathlib import Path

import mujoco
import numpy as np

from sim.errors import InputError, one_line
from sim.rooms.spec import drop_claims, make_static

CPU_S = 10
MEMORY_BYTES = 2 * 1024**3
FARTHEST_M = 1e10
"""Largest coordinate and size of a geom [m]."""
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_REFUSED = {"plugin": "plugins", "extension": "extensions", "flex": "flexible bodies", "flexcomp": "flexible bodies"}


def try_out(path: Path, is_room: bool) -> list[Path]:
    """Read and compile an MJCF file; return the files that it uses, itself first.

    Raises:
        InputError: It is no MJCF file, names a file outside its own folder, or MuJoCo cannot compile it.
    """
    files = list_files(path)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        (make_static if is_room else drop_claims)(spec)
        model = spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"MuJoCo cannot read it: {one_line(error)[:400]}") from None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for values in (data.geom_xpos, data.geom_xmat, model.geom_size):
        if not (np.abs(values) < FARTHEST_M).all():
            raise InputError("a geom is infinitely large or far away")
    return files


def list_files(path: Path) -> list[Path]:
    """The files that an MJCF file uses, itself first; raises InputError if one is outside its folder."""
    roots, queue = dict[Path, ET.Element](), [path]
    while queue:
        file = queue.pop()
        if file in roots:
            continue
        root = roots[file] = _parse(file)
        for element in root.iter():
            if element.tag in _REFUSED:
                raise InputError(f"{_REFUSED[element.tag]} are not allowed (<{element.tag}>)")
            if element.tag in {"include", "model"} and "file" in element.attrib:
                queue += _find(element, "file", path.parent, {path.parent, file.parent})
    if roots[path].tag != "mujoco":
        raise InputError(f"not an MJCF file: its root is <{roots[path].tag}>, and must be <mujoco>")
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


def main() -> None:
    """Print the files, or the reason why the file is refused, as JSON."""
    for limit, most in ((resource.RLIMIT_CPU, CPU_S), (resource.RLIMIT_DATA, MEMORY_BYTES), (resource.RLIMIT_CORE, 0)):
        resource.setrlimit(limit, (most, resource.getrlimit(limit)[1]))
    mujoco.set_mju_user_warning(lambda text: None)
    kind, path = sys.argv[1:]
    try:
        print(json.dumps({"files": [str(file) for file in try_out(Path(path), kind == "room")]}))
    except InputError as error:
        print(json.dumps({"refused": str(error)}))


if __name__ == "__main__":
    main()
