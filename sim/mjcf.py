"""A room of your own: an MJCF file, vetted before MuJoCo reads it, and made a room that only stands there."""

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

from sim.errors import InputError, one_line

FLOOR = "floor"
LARGEST_BYTES = 64 * 1024 * 1024
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_REFUSED = {"plugin": "plugins", "extension": "extensions", "flex": "flexible bodies", "flexcomp": "flexible bodies"}
_SUPPORT_M = 0.001


def load_room(path: Path) -> mujoco.MjSpec:
    """Read an MJCF file as a room: everything in it stands still, nothing of it acts, its own floor is kept.

    Files that it includes or draws on must lie in its own folder. A floor is a plane, or a horizontal top of a box, at
    z = 0; where there is none, an endless plane ``floor`` is added.

    Raises:
        InputError: the file is missing, is not MJCF, reaches out of its folder, or asks for plugins; one line.
    """
    try:
        _vet(path)
        spec = mujoco.MjSpec.from_file(str(path.resolve()))
        _still(spec)
        model = spec.compile()
    except InputError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        reason = one_line(error)
        raise InputError(f"room.mjcf {path}: MuJoCo cannot read it: {reason}") from None
    if not _has_floor(model):
        name = FLOOR if spec.geom(FLOOR) is None else f"{FLOOR}_below"
        spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), group=3)
    return spec


def _vet(path: Path) -> None:
    """Refuse a file that could make MuJoCo open anything outside its folder, before MuJoCo sees it."""
    what = f"room.mjcf {path}"
    folder = path.resolve().parent
    files = _read_all(path, path, folder, [])
    if files[path].tag != "mujoco":
        raise InputError(f"{what}: not an MJCF file: its root is <{files[path].tag}>, and must be <mujoco>")
    # Which of these folders MuJoCo looks in depends on the file that says so last: a reference must be good in all.
    places = {folder} | {file.resolve().parent for file in files}
    for root in files.values():
        for compiler in root.iter("compiler"):
            for key in _FOLDERS:
                if compiler.get(key):
                    places |= {_inside(compiler.get(key, ""), base, folder, f"{what}: {key}") for base in places}
    for root in files.values():
        for element in root.iter():
            if element.tag in _REFUSED:
                raise InputError(f"{what}: {_REFUSED[element.tag]} are not allowed (<{element.tag}>)")
            for name, value in element.attrib.items():
                if name.startswith("file"):
                    for place in places:
                        _inside(value, place, folder, f"{what}: {element.tag} {name}")


def _read_all(path: Path, main: Path, folder: Path, chain: list[Path]) -> dict[Path, ET.Element]:
    """The parsed file and all that it includes or attaches, each by its path."""
    if path in chain:
        raise InputError(f"room.mjcf {main}: {path.name} includes itself")
    root = _parse(path, main)
    files = {path: root}
    for element in root.iter():
        if element.tag == "include" or (element.tag == "model" and "file" in element.attrib):
            value = element.get("file", "")
            what = f"room.mjcf {main}: {element.tag} file"
            candidates = [_inside(value, base, folder, what) for base in (folder, path.resolve().parent)]
            found = next((file for file in candidates if file.is_file()), None)
            if found is None:
                raise InputError(f"{what} {value}: no such file")
            files |= _read_all(found, main, folder, [*chain, path.resolve()])
    return files


def _parse(path: Path, main: Path) -> ET.Element:
    what = f"room.mjcf {main}"
    try:
        if not path.is_file():
            raise InputError(f"{what}: no such file")
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(f"{what}: {path.name} is larger than {LARGEST_BYTES // 2**20} MiB")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{what}: {path.name} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{what}: {path.name} is not UTF-8 text") from None
    # Entities could name other files, or grow without end; MJCF has no use for them.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{what}: a DOCTYPE or an entity is not allowed in {path.name}")
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise InputError(f"{what}: not XML: {error} in {path.name}") from None


def _inside(value: str, base: Path, folder: Path, what: str) -> Path:
    """The file that a reference names, refused unless it and all links on its way lie in ``folder``."""
    if Path(value).is_absolute() or "\\" in value or ":" in value:
        raise InputError(f"{what} {value}: must be a path relative to the room's own folder")
    target = (base / value).resolve()
    if ".." in Path(value).parts or not target.is_relative_to(folder):
        raise InputError(f"{what} {value}: lies outside the room's own folder")
    return target


def _still(spec: mujoco.MjSpec) -> None:
    """Take away all that moves, acts, measures or decides about contacts, so that a room only stands there."""
    acting = (spec.keys, spec.sensors, spec.actuators, spec.equalities, spec.tendons, spec.pairs, spec.excludes)
    for element in [element for group in (*acting, spec.joints, spec.skins) for element in group]:
        spec.delete(element)
    for body in spec.bodies:
        body.mocap = False


def _has_floor(model: mujoco.MjModel) -> bool:
    """Whether something horizontal at z = 0 collides and could carry the robot."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        if not (model.geom_contype[geom] & 1 or model.geom_conaffinity[geom] & 1):
            continue
        up = data.geom_xmat[geom].reshape(3, 3)[2]
        height = data.geom_xpos[geom, 2]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE and up[2] > 0.9999:
            top = height
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX and np.abs(up).max() > 0.9999:
            top = height + np.abs(up) @ model.geom_size[geom]
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_HFIELD:
            top = height
        else:
            continue
        if abs(top) < _SUPPORT_M:
            return True
    return False
