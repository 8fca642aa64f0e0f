"""A room of your own: an MJCF file, vetted before MuJoCo reads it, and made a room that only stands there."""

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

from sim.errors import InputError

FLOOR = "floor"
LARGEST_BYTES = 64 * 1024 * 1024
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_FOLDER_OF = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "flexcomp": "meshdir", "texture": "texturedir"}
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
        _vet(path, path.resolve().parent, [])
        spec = mujoco.MjSpec.from_file(str(path.resolve()))
        _still(spec)
        model = spec.compile()
    except InputError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"room.mjcf {path}: MuJoCo cannot read it: {reason}") from None
    if not _has_floor(model):
        name = FLOOR if spec.geom(FLOOR) is None else f"{FLOOR}_below"
        spec.worldbody.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 1), group=3)
    return spec


def _vet(path: Path, folder: Path, chain: list[Path]) -> None:
    """Refuse a file, or one that it includes, that could make MuJoCo open anything outside ``folder``."""
    root = _parse(path, chain[0] if chain else path)
    name = chain[0] if chain else path
    if not chain and root.tag != "mujoco":
        raise InputError(f"room.mjcf {name}: not an MJCF file: its root is <{root.tag}>, and must be <mujoco>")
    if path.resolve() in [link.resolve() for link in chain]:
        raise InputError(f"room.mjcf {name}: {path.name} includes itself")
    directories = _directories(root, name)
    for element in root.iter():
        if element.tag in _REFUSED:
            raise InputError(f"room.mjcf {name}: {_REFUSED[element.tag]} are not allowed (<{element.tag}>)")
        if element.tag == "include":
            included = _inside(element.get("file", ""), "", folder, f"room.mjcf {name}: include")
            _vet(included, folder, [*chain, path])
        elif element.tag == "model":
            _vet(_inside(element.get("file", ""), "", folder, f"room.mjcf {name}: model"), folder, [*chain, path])
        else:
            for attribute, value in element.attrib.items():
                if attribute.startswith("file") and value:
                    inner = directories.get(_FOLDER_OF.get(element.tag, ""), "")
                    _inside(value, inner, folder, f"room.mjcf {name}: {element.tag} {attribute}")


def _parse(path: Path, name: Path) -> ET.Element:
    try:
        if not path.is_file():
            raise InputError(f"room.mjcf {name}: no such file" + ("" if path == name else f": {path.name}"))
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(f"room.mjcf {name}: larger than {LARGEST_BYTES // 2**20} MiB")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"room.mjcf {name}: cannot be read: {error.strerror}") from None
    # Entities could name other files, or grow without end; MJCF has no use for them.
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data or b"\0" in data:
        raise InputError(f"room.mjcf {name}: a DOCTYPE, an entity or UTF-16 text is not allowed in {path.name}")
    try:
        return ET.fromstring(data)
    except (ET.ParseError, LookupError, ValueError) as error:
        raise InputError(f"room.mjcf {name}: not XML: {error} in {path.name}") from None


def _directories(root: ET.Element, name: Path) -> dict[str, str]:
    """The asset folders that the file's compiler element names, which may be none."""
    found = {}
    for compiler in root.iter("compiler"):
        for key in _FOLDERS:
            value = compiler.get(key)
            if value is None:
                continue
            if key == "assetdir":
                found.setdefault("meshdir", value)
                found.setdefault("texturedir", value)
            else:
                found[key] = value
    return found


def _inside(value: str, inner: str, folder: Path, what: str) -> Path:
    """The file that a reference names, refused unless it and all links on its way lie in ``folder``."""
    if not value:
        raise InputError(f"{what}: names no file")
    target = (folder / inner / value).resolve()
    if Path(value).is_absolute() or Path(inner).is_absolute() or "\\" in value + inner:
        raise InputError(f"{what} {value}: must be a path relative to the room's own folder")
    if not target.is_relative_to(folder):
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
