"""Furniture to sit and lie on: sofa, armchair, chair, office chair, stool, bed."""

import mujoco
import numpy as np

from sim.rooms.furniture.primitives import Footprint, Look, ball, block, box, pole, turned


def sofa(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, width_m: float = 2.1) -> Footprint:
    """A sofa with two or three seats, arms and a cushion at each end."""
    depth, arm, seat_top = 0.9, 0.2, 0.43
    inner = width_m - 2 * arm
    back_top = rng.uniform(0.8, 0.92)
    box(body, (0, 0.03, 0.2), (width_m - 0.04, depth - 0.06, 0.26), look.fabric)
    box(body, (0, depth / 2 - 0.11, (0.3 + back_top) / 2), (inner, 0.22, back_top - 0.3), look.fabric)
    for side in (-1, 1):
        box(body, (side * (width_m - arm) / 2, 0, 0.34), (arm, depth, 0.56), look.fabric)
    seats = 3 if inner > 1.5 else 2
    for seat in range(seats):
        x = (seat - (seats - 1) / 2) * inner / seats
        box(body, (x, -0.12, seat_top - 0.06), (inner / seats - 0.02, depth - 0.26, 0.13), look.fabric)
    for side in (-1, 1):
        tilt = turned(rng.uniform(-0.3, -0.2), (1.0, 0.0, 0.0))
        box(body, (side * (inner / 2 - 0.25), 0.13, 0.62), (0.42, 0.12, 0.38), look.cushion, quat=tilt)
    block(body, (0, 0, 0.31), (width_m, depth, 0.62))
    block(body, (0, depth / 2 - 0.11, back_top / 2), (inner, 0.22, back_top))
    return Footprint(width_m, depth, back_top, front_m=0.45)


def armchair(body: mujoco.MjsBody, rng: np.random.Generator, look: Look) -> Footprint:
    """A padded chair with arms."""
    width, depth = rng.uniform(0.8, 0.9), 0.85
    box(body, (0, -0.05, 0.26), (width - 0.3, depth - 0.15, 0.36), look.second_fabric)
    box(body, (0, depth / 2 - 0.1, 0.52), (width - 0.04, 0.2, 0.92), look.second_fabric)
    for side in (-1, 1):
        box(body, (side * (width / 2 - 0.08), -0.04, 0.33), (0.16, depth - 0.1, 0.58), look.second_fabric)
    box(body, (0, 0.15, 0.62), (0.4, 0.12, 0.36), look.cushion, quat=turned(-0.3, (1.0, 0.0, 0.0)))
    block(body, (0, 0, 0.31), (width, depth, 0.62))
    block(body, (0, depth / 2 - 0.1, 0.5), (width, 0.2, 0.98))
    return Footprint(width, depth, 0.98, front_m=0.35)


def chair(body: mujoco.MjsBody, rng: np.random.Generator, look: Look) -> Footprint:
    """A chair with a straight back; stretchers join its legs on all sides, so that no robot drives under the seat."""
    width, depth, back_top = 0.44, 0.46, rng.uniform(0.86, 0.98)
    wood = look.wood
    x, y = width / 2 - 0.022, depth / 2 - 0.022
    for at, tall in (((-x, -y), 0.43), ((x, -y), 0.43), ((-x, y), back_top), ((x, y), back_top)):
        box(body, (*at, tall / 2), (0.045, 0.045, tall), wood, solid=True)
    box(body, (0, 0, 0.45), (width, depth, 0.045), look.cushion, solid=True)
    box(body, (0, y, back_top - 0.13), (width - 0.08, 0.03, 0.22), wood, solid=True)
    for side in (-1, 1):
        box(body, (0, side * y, 0.13), (2 * x, 0.03, 0.06), wood, solid=True)
        box(body, (side * x, 0, 0.13), (0.03, 2 * y, 0.06), wood, solid=True)
    return Footprint(width, depth, back_top)


def office_chair(body: mujoco.MjsBody, rng: np.random.Generator, look: Look) -> Footprint:
    """A swivel chair on a star-shaped base with castors."""
    back_top = rng.uniform(0.95, 1.15)
    for angle in (0.3, 1.35, 2.4):
        box(body, (0, 0, 0.045), (0.58, 0.05, 0.08), look.black, solid=True, quat=turned(angle))
    pole(body, (0, 0, 0.26), 0.03, 0.36, look.metal, solid=True)
    box(body, (0, 0, 0.47), (0.48, 0.48, 0.08), look.second_fabric, solid=True)
    box(body, (0, 0.23, 0.52), (0.06, 0.04, 0.3), look.black)
    box(body, (0, 0.22, (0.6 + back_top) / 2), (0.46, 0.07, back_top - 0.6), look.second_fabric, solid=True)
    return Footprint(0.58, 0.58, back_top)


def stool(body: mujoco.MjsBody, rng: np.random.Generator, look: Look) -> Footprint:
    """A round stool on one foot."""
    height = rng.uniform(0.6, 0.7)
    pole(body, (0, 0, 0.015), 0.18, 0.03, look.metal, solid=True)
    pole(body, (0, 0, height / 2), 0.03, height - 0.04, look.metal, solid=True)
    pole(body, (0, 0, height - 0.03), 0.18, 0.06, look.cushion, solid=True)
    return Footprint(0.36, 0.36, height)


def bed(body: mujoco.MjsBody, rng: np.random.Generator, look: Look, width_m: float = 1.6) -> Footprint:
    """A bed with headboard, footboard, mattress, pillows and a duvet folded back at the head."""
    length, head_top = 2.08, rng.uniform(0.95, 1.25)
    box(body, (0, 0, 0.2), (width_m, length - 0.1, 0.24), look.wood)
    box(body, (0, length / 2 - 0.03, head_top / 2), (width_m + 0.06, 0.06, head_top), look.dark_wood)
    box(body, (0, -length / 2 + 0.03, 0.25), (width_m + 0.04, 0.05, 0.5), look.dark_wood)
    box(body, (0, 0.0, 0.4), (width_m - 0.06, length - 0.14, 0.18), look.white)
    box(body, (0, -0.28, 0.47), (width_m + 0.02, length - 0.66, 0.14), look.fabric)
    box(body, (0, 0.38, 0.56), (width_m - 0.02, 0.24, 0.06), look.second_fabric)
    pillows = 2 if width_m > 1.2 else 1
    for pillow in range(pillows):
        x = (pillow - (pillows - 1) / 2) * width_m / 2
        ball(body, (x, length / 2 - 0.28, 0.56), (0.32, 0.2, 0.1), look.white)
    block(body, (0, 0, 0.27), (width_m + 0.04, length, 0.54))
    block(body, (0, length / 2 - 0.03, head_top / 2), (width_m + 0.06, 0.06, head_top))
    return Footprint(width_m + 0.06, length, head_top, front_m=0.0)
