"""How fast pictures are: our camera against MuJoCo's own renderer, and how many images several processes draw."""

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from copy import deepcopy
from threading import Barrier, BrokenBarrierError

import mujoco
import numpy as np

from sim.errors import WorkError
from sim.processes import WORKERS
from sim.recording.sensing import draw_states, open_camera
from sim.robot.world import RoomWorld
from sim.sensors.fisheye import CAMERA_SITE, Fisheye
from sim.settings import SimSettings

CHUNK = 64
START_S = 120.0
# azimuth, elevation [deg] of the cube's five upper sides
SIDES = ((0, 90), (0, 0), (90, 0), (180, 0), (270, 0))


def measure_rendering(settings: SimSettings, poses: np.ndarray, repeats: int) -> dict[str, float]:
    """Seconds of one observation by our camera, and of five faces by ``mujoco.Renderer``, which get no fisheye for it.

    Args:
        settings: The room and the camera; a face of either way is ``face_px`` wide.
        poses: Poses (n, 3) x, y [m], yaw [rad], all of which each way draws in turn.
        repeats: How often; the medians count.

    Returns:
        ``fisheye``; ``faces``: without shadows and oversampling, primitives as fine as by default; ``plain``: with
        MuJoCo's defaults, shadows among them; each in seconds, and ``geoms`` in the room.
    """
    world = RoomWorld(settings)
    states = world.rest_states(poses)
    fast, plain = _as_by_default(world.model), _as_by_default(world.model)
    fast.vis.quality.offsamples = 0
    fast.light_castshadow[:] = False
    plain.light_castshadow[:] = True
    size = settings.camera.face_px
    with (
        Fisheye(world.model, settings.camera) as fisheye,
        mujoco.Renderer(fast, size, size) as faces,
        mujoco.Renderer(plain, size, size) as defaults,
    ):
        faces.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        ways: dict[str, Callable[[], object]] = {
            "fisheye": lambda: fisheye.polar(world.data),
            "faces": lambda: _draw_sides(faces, world.data),
            "plain": lambda: _draw_sides(defaults, world.data),
        }
        seconds: dict[str, list[float]] = {name: [] for name in ways}
        for way in ways.values():  # the first picture of each costs more
            _time(way, world, states[:1])
        for _ in range(repeats):
            for name, way in ways.items():
                seconds[name].append(_time(way, world, states))
    return {**{name: float(np.median(each)) for name, each in seconds.items()}, "geoms": float(world.room.ngeom)}


def draw_poses(settings: SimSettings, poses: np.ndarray, processes: int = 2) -> tuple[np.ndarray, float]:
    """Draw what the robot sees at rest at poses (n, 3); returns images (n, rings, sectors, 3) and images a second.

    The seconds count from when all processes are ready, and with the way of the images back to this one.
    """
    ready = WORKERS.Barrier(processes + 1)
    # as many parts as processes at least: each part starts one, and they wait for one another
    parts = np.array_split(poses, max(processes, len(poses) // CHUNK))
    with ProcessPoolExecutor(processes, WORKERS, _get_ready, (settings, ready)) as pool:
        try:
            jobs = [pool.submit(_draw, settings, part) for part in parts]
            ready.wait(START_S)
            start = time.perf_counter()
            images = np.concatenate([job.result() for job in jobs])
            rate = len(poses) / (time.perf_counter() - start)
        except (BrokenProcessPool, BrokenBarrierError):
            raise WorkError("a rendering process died; deepgps doctor checks the renderer") from None
    return images, rate


def _as_by_default(model: mujoco.MjModel) -> mujoco.MjModel:
    # A copy with MuJoCo's own quality of pictures, and an eye that sees a quarter of the circle.
    model, usual = deepcopy(model), mujoco.MjSpec().visual.quality
    for name in ("numslices", "numstacks", "numquads", "offsamples", "shadowsize"):
        setattr(model.vis.quality, name, getattr(usual, name))
    model.vis.global_.fovy = 90.0
    return model


def _time(way: Callable[[], object], world: RoomWorld, states: np.ndarray) -> float:
    start = time.perf_counter()
    for state in states:
        _stand(world, state)
        way()
    return (time.perf_counter() - start) / len(states)


def _draw_sides(renderer: mujoco.Renderer, data: mujoco.MjData) -> list[np.ndarray]:
    view = mujoco.MjvCamera()
    view.lookat[:], view.distance = data.site(CAMERA_SITE).xpos, 1e-3
    pictures = []
    for view.azimuth, view.elevation in SIDES:
        renderer.update_scene(data, view)
        pictures.append(renderer.render())
    return pictures


def _stand(world: RoomWorld, state: np.ndarray) -> None:
    world.data.qpos[:] = state
    mujoco.mj_kinematics(world.model, world.data)


def _get_ready(settings: SimSettings, ready: Barrier) -> None:
    try:
        _draw(settings, np.zeros((1, 3)))
    except Exception:
        ready.abort()  # or the others would wait for this one
        raise
    ready.wait(START_S)


def _draw(settings: SimSettings, poses: np.ndarray) -> np.ndarray:
    world, _ = open_camera(settings)  # pyright: ignore[reportArgumentType] (frozen settings do hash)
    return draw_states(settings, world.rest_states(poses))
