"""Models of rooms: an empty one, and copies in which nothing moves or nothing is drawn."""

import mujoco

from sim.errors import InputError, shorten

ROBOT_PREFIX = "robot/"  # Prefix of the names of the robot's parts once it is attached to a room
DRAWN_GROUPS = (0, 1, 2)  # Groups of the geoms that cameras see
NEAR_PLANE_M = 0.01  # Distance from a camera within which nothing is drawn [m]
_SIZES = ("njmax", "nconmax", "nstack", "nkey", "nuserdata", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site")
_SIZES += ("nuser_cam", "nuser_tendon", "nuser_actuator", "nuser_sensor")


def empty_room() -> mujoco.MjSpec:
    """Return a room that has only an infinite floor."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 0.05))
    return spec


def freeze(room: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a room without anything that moves, drives, measures, or would alter contacts with the robot."""
    spec = room.copy()
    make_static(spec)
    for geom in spec.geoms:
        # The robot's geoms have priority 2, so their friction and stiffness apply. Margins would add up.
        geom.priority, geom.margin, geom.gap = 0, 0.0, 0.0
    # Compiler options that would change every mass of the model, the robot's too.
    spec.compiler.settotalmass = -1.0
    spec.compiler.boundmass = spec.compiler.boundinertia = 0.0
    spec.compiler.inertiafromgeom = mujoco.MjSpec().compiler.inertiafromgeom
    return spec


def make_static(spec: mujoco.MjSpec) -> None:
    """Remove all that moves, acts, measures, alters contacts or claims memory."""
    active = (spec.keys, spec.sensors, spec.actuators, spec.equalities, spec.tendons, spec.pairs, spec.excludes)
    for element in [element for group in (*active, spec.joints, spec.skins) for element in group]:
        spec.delete(element)
    for body in spec.bodies:
        body.mocap = False
    drop_claims(spec)


def drop_claims(spec: mujoco.MjSpec) -> None:
    """Set the sizes for which a model claims memory to MuJoCo's own."""
    defaults = mujoco.MjSpec()
    spec.memory = defaults.memory
    for name in _SIZES:
        setattr(spec, name, getattr(defaults, name))
    spec.visual.global_.offwidth = defaults.visual.global_.offwidth
    spec.visual.global_.offheight = defaults.visual.global_.offheight


def strip_robot(spec: mujoco.MjSpec) -> None:
    """Remove claims for memory, and unread what is only looked at: textures, skins, and meshes that collide with
    nothing, with their mass. What a pair says of the contact of a geom with a floor becomes the geom's own.

    Raises InputError if a part of the robot that collides is a mesh.
    """
    drop_claims(spec)
    for pair in list(spec.pairs):
        both = [geom for geom in map(spec.geom, (pair.geomname1, pair.geomname2)) if geom is not None]
        own = [geom for geom in both if geom.parent.name != "world"]
        if len(own) < 2:
            for geom in own:
                geom.condim, geom.friction = pair.condim, pair.friction[[0, 2, 3]]
                geom.solref, geom.solimp = pair.solref, pair.solimp
            spec.delete(pair)
    for geom in [geom for geom in spec.geoms if geom.meshname or geom.hfieldname]:
        if (geom.contype or geom.conaffinity) and geom.parent.name != "world":
            name = shorten(geom.name or geom.meshname or geom.hfieldname)
            raise InputError(f"its geom {name} is a mesh that collides, and what collides must be a primitive geom")
        spec.delete(geom)
    for element in [*spec.meshes, *spec.hfields, *spec.skins, *spec.textures]:
        spec.delete(element)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)


def bare(room: mujoco.MjSpec) -> mujoco.MjSpec:
    """Copy a room without the geoms that nothing can touch."""
    spec = room.copy()
    for geom in list(spec.geoms):
        if not (geom.contype | geom.conaffinity) & 1:
            spec.delete(geom)
    return spec


def compile_solid(room: mujoco.MjSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Compile the colliding geoms of a room, which are what rays can meet; return the model and its state."""
    spec = bare(freeze(room))
    for geom in spec.geoms:
        # Rays pass through fully transparent geoms, and collision geoms are often drawn so.
        geom.rgba[3], geom.material = 1.0, ""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data
