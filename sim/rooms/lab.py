"""What makes a room a laboratory: AprilTags on the walls and on free-standing posts."""

from functools import partial

import mujoco
import numpy as np

from sim.apriltag.detector import PLATE_M, TAGS, draw_tag
from sim.errors import InputError
from sim.rooms.furniture.primitives import Footprint, Look, box, multiply, paper, turned
from sim.rooms.layout import Pose
from sim.rooms.placement import Room, centre, hang

POSTS = 3
POST_M, POST_HEIGHT_M = 0.26, 1.3
POST_TAGS_M = (0.3, 0.72)  # Heights of the tags on each face of a post [m]
WALL_TAGS_M = (0.22, 1.25)  # Lowest and highest centre of a tag on a wall [m]
PLATE_THICKNESS_M = 0.006
TRIES = 40


def place_posts(room: Room) -> int:
    """Place posts with tags on all faces where they leave paths; return the number of tags on them."""
    tags = 0
    stood: list[Pose] = []
    for _ in range(POSTS):
        piece = partial(post, first=tags)
        pose = centre(room, "post", piece, lambda at: _nearness(at, stood), turns=(0.0,))
        if pose is not None:
            stood.append(pose)
            tags += 4 * len(POST_TAGS_M)
    return tags


def hang_tags(room: Room, first: int) -> None:
    """Hang the tags from number ``first`` on along the walls; raise InputError if they do not fit."""
    for number in range(first, TAGS):
        material = paper(room.look.spec, draw_tag(number))
        for _ in range(TRIES):
            piece = partial(wall_tag, number=number, material=material, z=float(room.rng.uniform(*WALL_TAGS_M)))
            if hang(room, "tag", piece) is not None:
                break
        else:
            raise InputError(f"room.kind lab: its walls have room for {number} tags, and it must have {TAGS}")


def post(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, first: int) -> Footprint:
    """A square post with tags, numbered from ``first``, one above the other on each face."""
    wood = look.dark_wood
    box(body, (0, 0, POST_HEIGHT_M / 2), (POST_M, POST_M, POST_HEIGHT_M), wood, solid=True)
    out = POST_M / 2
    for face in range(4):
        yaw = face * np.pi / 2
        for row, z in enumerate(POST_TAGS_M):
            number = first + len(POST_TAGS_M) * face + row
            place = (float(out * np.sin(yaw)), float(-out * np.cos(yaw)), z)
            _plate(body, number, paper(look.spec, draw_tag(number)), place, yaw)
    side = POST_M + 2 * PLATE_THICKNESS_M
    return Footprint(side, side, POST_HEIGHT_M)


def wall_tag(
    body: mujoco.MjsBody, rng: np.random.Generator, look: Look, number: int, material: str, z: float
) -> tuple[float, float, float]:
    """A tag on a wall."""
    _plate(body, number, material, (0.0, 0.0, z), 0.0)
    return PLATE_M, z - PLATE_M / 2, z + PLATE_M / 2


def _plate(body: mujoco.MjsBody, number: int, material: str, at: tuple[float, float, float], yaw: float) -> None:
    """Add a tag's plate with its back at ``at``, turned by ``yaw`` from facing -y, and a site with the tag's frame."""
    out = np.array((np.sin(yaw), -np.cos(yaw), 0.0))
    x, y, z = (np.array(at) + out * PLATE_THICKNESS_M / 2).tolist()
    box(body, (x, y, z), (PLATE_M, PLATE_THICKNESS_M, PLATE_M), material, quat=turned(yaw))
    front = np.array(at) + out * PLATE_THICKNESS_M
    body.add_site(name=f"tag_{number}", pos=front, quat=multiply(turned(yaw), turned(np.pi / 2, (1.0, 0.0, 0.0))))


def _nearness(at: Pose, others: list[Pose]) -> float:
    return -min((min(float(np.hypot(at.x - o.x, at.y - o.y)), 2.5) for o in others), default=0.0)
