"""Rendering speed: our camera against MuJoCo's own renderer, and the image rate of several worker processes."""

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
from sim.recording.sensing import observe
from sim.robot.world import RoomWorld
from sim.sensors.camera.fisheye import CAMERA_SITE, Fisheye
from sim.settings import SimSettings

CHUNK = 64
START_S = 120.0
# azimuth, elevation [deg] of the cube's five upper sides
SIDES = ((0, 90), (0, 0), (90, 0), (180, 0), (270, 0))


def measure_rendering(settings: SimSettings, poses: np.ndarray, repeats: int) -> dict[str, float]:
    """Measure the time of one fisheye observation by our camera, and of five plain faces by ``mujoco.Renderer``.

    Args:
        settings: The room and the camera; a face is ``face_px`` wide with either renderer.
        poses: Poses (n, 3) x, y [m], yaw [rad]; each renderer draws all of them in turn.
        repeats: Number of repetitions, of which the median is returned.

    Returns:
        ``fisheye``: our camera; ``faces``: without shadows and oversampling, primitives as fine as by default;
        ``plain``: with MuJoCo's defaults, including shadows; each in seconds; and the number of ``geoms`` in the room.
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
        for way in ways.values():  # the first image of each takes longer
            _time(way, world, states[:1])
        for _ in range(repeats):
            for name, way in ways.items():
                seconds[name].append(_time(way, world, states))
    return {**{name: float(np.median(each)) for name, each in seconds.items()}, "geoms": float(world.room.ngeom)}


def draw_poses(settings: SimSettings, poses: np.ndarray, processes: int = 2) -> tuple[np.ndarray, float]:
    """Draw what the robot sees at rest at poses (n, 3); return images (n, rings, sectors, 3) and images per second.

    Timing starts when all worker processes are ready and includes the transfer of the images to this process.
    """
    processes = min(processes, len(poses))
    ready = WORKERS.Barrier(processes + 1)
    # at least as many parts as processes: each part starts a process, and the processes wait for one another
    states = RoomWorld(settings, drawn=False).rest_states(poses)
    parts = np.array_split(states, max(processes, len(states) // CHUNK))
    with ProcessPoolExecutor(processes, WORKERS, _get_ready, (settings, states[:1], ready)) as pool:
        try:
            jobs = [pool.submit(observe, "fisheye", settings, part) for part in parts]
            ready.wait(START_S)
            start = time.perf_counter()
            images = np.concatenate([job.result() for job in jobs])
            rate = len(poses) / (time.perf_counter() - start)
        except (BrokenProcessPool, BrokenBarrierError):
            raise WorkError("a rendering process died; deepgps doctor checks the renderer") from None
    return images, rate


def _as_by_default(model: mujoco.MjModel) -> mujoco.MjModel:
    # A copy with MuJoCo's default image quality and a 90 degree field of view.
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


def _get_ready(settings: SimSettings, states: np.ndarray, ready: Barrier) -> None:
    try:
        observe("fisheye", settings, states)
    except Exception:
        ready.abort()  # otherwise the others would wait for this one
        raise
    ready.wait(START_S)
