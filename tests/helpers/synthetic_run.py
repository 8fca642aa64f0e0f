"""A small made-up run folder in the real formats, for tests of what shows a run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.ndimage import distance_transform_edt, gaussian_filter

from deepgps.evaluation.error_field import ErrorField, write_fields
from deepgps.evaluation.measures import summarise_acceptance
from sim.files.checksums import write_arrays, write_json, write_lines
from sim.geometry import FreeSpace, save_free_space, wrap
from sim.recording.format import write_files

WIDTH_M, DEPTH_M, RADIUS_M = 7.0, 4.3, 0.105
WHEEL_RADIUS_M, TRACK_M, TICKS_PER_REV = 0.033, 0.16, 4096
CELL_M = 0.02
# name: middle x, y [m], extent x, y, z [m], colour
FURNITURE = {
    "sofa": (-2.2, -1.6, 2.0, 0.9, 0.8, (70, 92, 120)),
    "table": (-2.0, 0.2, 1.1, 0.6, 0.45, (150, 110, 70)),
    "shelf": (0.8, 1.95, 1.6, 0.35, 2.0, (120, 85, 55)),
    "wardrobe": (3.1, 1.3, 0.6, 1.4, 2.1, (205, 200, 190)),
    "plant": (2.9, -1.7, 0.5, 0.5, 1.3, (60, 120, 60)),
    "desk": (1.0, -0.9, 1.2, 0.6, 0.75, (165, 130, 90)),
}
# error in the middle of the room [m], share of lost places
METHODS = {"deepgps": (0.02, 0.01), "posenet": (0.025, 0.02), "knn": (0.04, 0.05), "dead_reckoned_labels": (0.18, 0.3)}
REFUSING = ("deepgps", "posenet")
"""Methods that refuse images."""


def write_synthetic_run(folder: Path, samples: int = 200, seed: int = 0, spacing_m: float = 0.16) -> Path:
    """Write a run folder with a made-up drive, error fields and training histories; returns it."""
    rng = np.random.default_rng(seed)
    space = make_free_space()
    pose, reading, time, wheel_angle = make_drive(space, samples, rng)
    test_pose = make_grid(space, spacing_m)
    _write_recording(folder / "recording", space, pose, reading, time, wheel_angle, test_pose)
    fields = {name: make_predictions(test_pose, *METHODS[name], rng) for name in METHODS}
    truth, heading = test_pose[:, 0, :2], test_pose[0, :, 2]
    measured = {name: ErrorField(truth, heading, predicted) for name, predicted in fields.items()}
    for name in REFUSING:
        measured[name] = refuse_some(measured[name], rng)
    write_fields(folder / "error_field.npz", measured)
    for name in METHODS:
        if name != "knn":
            write_arrays(folder / name / "history.npz", make_history(pose[:, :2], METHODS[name][0], rng))
    metrics = make_metrics(truth, fields, samples)
    for name, field in measured.items():
        metrics["methods"][name] |= summarise_acceptance(field)
    write_json(folder / "metrics.json", metrics)
    write_lines(folder / "scenario.yaml", "name: living_room\n")
    return folder


def make_free_space() -> FreeSpace:
    """Free space of a rectangular room with boxes in it."""
    x = np.arange(-WIDTH_M / 2 - 0.1, WIDTH_M / 2 + 0.1, CELL_M)
    y = np.arange(-DEPTH_M / 2 - 0.1, DEPTH_M / 2 + 0.1, CELL_M)
    grid_x, grid_y = np.meshgrid(x, y)
    empty = (np.abs(grid_x) < WIDTH_M / 2) & (np.abs(grid_y) < DEPTH_M / 2)
    for middle_x, middle_y, width, depth, _, _ in FURNITURE.values():
        empty &= (np.abs(grid_x - middle_x) > width / 2) | (np.abs(grid_y - middle_y) > depth / 2)
    free = np.asarray(distance_transform_edt(empty)) * CELL_M > RADIUS_M
    return FreeSpace(np.array([x[0], y[0]]), CELL_M, free, free.copy(), np.zeros(2), DEPTH_M)


def make_drive(space: FreeSpace, samples: int, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Straight segments with turns in place: pose (N, 3), reading (R, 4), time (R,), wheel angle (R, 2)."""
    here, observation = space.start.astype(float), -1
    pose, reading, time, angle = [], [], [], []
    wheel, clock, segment = np.zeros(2), 0.0, 0
    yaw = 0.0
    while len(pose) < samples:
        distance, target_yaw = 0.0, rng.uniform(-np.pi, np.pi)
        direction = np.array([np.cos(target_yaw), np.sin(target_yaw)])
        turn = wrap(target_yaw - yaw)
        if not space.is_free(here + 0.4 * direction):
            continue
        wheel += np.array([-turn, turn]) * TRACK_M / 2 / WHEEL_RADIUS_M
        clock, yaw = clock + abs(turn) / 1.8, target_yaw
        while True:
            if distance > 0 or observation < 0:  # a turning place is one observation with two readings
                observation += 1
                pose.append([*here, yaw])
            reading.append([segment, observation, *np.floor(wheel * TICKS_PER_REV / (2 * np.pi))])
            time.append(clock)
            angle.append(wheel.copy())
            if distance > 3.0 or len(pose) >= samples or not space.is_free(here + 0.08 * direction):
                break
            distance, clock, here = distance + 0.08, clock + 0.08 / 0.22, here + 0.08 * direction
            wheel += 0.08 / WHEEL_RADIUS_M
        segment += 1
    return np.array(pose), np.array(reading, np.int64), np.array(time), np.array(angle)


def make_grid(space: FreeSpace, spacing_m: float, headings: int = 4) -> np.ndarray:
    """Test poses (C, H, 3) on a grid over the reachable cells."""
    x = np.arange(-WIDTH_M / 2, WIDTH_M / 2, spacing_m)
    y = np.arange(-DEPTH_M / 2, DEPTH_M / 2, spacing_m)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    places = places[space.is_reachable(places)]
    yaw = np.arange(headings) * 2 * np.pi / headings
    return np.concatenate(
        [
            np.repeat(places[:, None], headings, axis=1),
            np.broadcast_to(yaw[None, :, None], (len(places), headings, 1)),
        ],
        axis=-1,
    )


def make_predictions(test_pose: np.ndarray, error_m: float, lost: float, rng: np.random.Generator) -> np.ndarray:
    """Predictions (C, H, 2): a smooth field of errors, larger at the walls, and a patch that is lost."""
    places = test_pose[..., :2]
    smooth = gaussian_filter(rng.standard_normal((2, 90, 60)), (0, 4, 4)) * 14
    cell = ((places + [3.6, 2.3]) / [7.2, 4.6] * [89, 59]).astype(int)
    field = np.moveaxis(smooth[:, cell[..., 0], cell[..., 1]], 0, -1)
    edge = np.max(np.abs(places) / [WIDTH_M / 2, DEPTH_M / 2], axis=-1, keepdims=True)
    error = error_m * (field + 0.4 * rng.standard_normal(places.shape)) * (0.6 + edge**6)
    distance = np.linalg.norm(places - [2.4, 0.2], axis=-1, keepdims=True)
    pull = (np.array([2.4, 0.2]) - places) * np.exp(-((distance / (3 * lost**0.5)) ** 2))
    return places + error + pull * min(4 * lost, 0.9)


def refuse_some(field: ErrorField, rng: np.random.Generator) -> ErrorField:
    """The field with a novelty that follows the errors, radii by it, and a tenth of the images refused, and a place."""
    novelty = (0.01 + field.error) * np.exp(0.3 * rng.standard_normal(field.error.shape))
    accepted = novelty < np.quantile(novelty, 0.9)
    accepted[-1] = False
    covariance = novelty[..., None, None] ** 2 * np.diag([0.8, 0.2])
    trust = {"accepted": accepted, "covariance": covariance, "reason": (~accepted).astype(np.int8)}
    return replace(field, novelty=novelty, radius=novelty, radius_95=2 * novelty, **trust)


def make_history(points: np.ndarray, error_m: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A loss that falls and snapshots that unfold, in a frame turned and mirrored against the world's."""
    step = np.arange(0, 4000, 20)
    loss = 0.5 * np.exp(-step / 400) + error_m * (1 + 0.1 * rng.standard_normal(len(step)))
    index = np.sort(rng.choice(len(points), min(len(points), 500), replace=False))
    snapshot_step = np.linspace(0, 3980, 30).astype(int)
    folded = np.stack([np.abs(points[index, 0]), points[index, 1]], axis=1) * 0.5
    blend = (1 - np.exp(-snapshot_step / 900))[:, None, None]
    positions = (1 - blend) * folded + blend * points[index]
    positions = positions + error_m * rng.standard_normal(positions.shape)
    mirrored = positions @ np.array([[0.6, 0.8], [0.8, -0.6]]) + [1.0, 2.0]
    return {
        "step": step,
        "loss": loss,
        "snapshot_step": snapshot_step,
        "snapshot": mirrored,
        "snapshot_index": index,
    }


def make_metrics(truth: np.ndarray, fields: dict[str, np.ndarray], samples: int) -> dict:
    """What evaluation writes into metrics.json."""
    methods = {}
    for name, predicted in fields.items():
        error = np.linalg.norm(predicted - truth[:, None], axis=-1).max(axis=1)
        rms = float(np.sqrt((error**2).mean()))
        methods[name] = {
            "rms_m": rms,
            **{f"p{p}_m" if p != 50 else "median_m": float(np.percentile(error, p)) for p in (50, 75, 95)},
            "max_m": float(error.max()),
            "relative_rms": rms / DEPTH_M,
            "scale": 1.0,
            "alignment": "E2" if name == "deepgps" else "SE2",
            "steps": 0 if name == "knn" else 4000,
            "train_s": 0.4 if name == "knn" else 61.2,
            "parameters": 0 if name == "knn" else 1_054_722,
        }
    return {
        "scenario": "living_room",
        "seed": 0,
        "shorter_side_m": DEPTH_M,
        "samples": samples,
        "segments": samples // 12,
        "distance_driven_m": samples * 0.08,
        "coverage": {"reachable_cells": len(truth), "cells_seen": len(truth) - 3},
        "trajectory": {"rms_m": 0.41, "max_m": 1.03},
        "methods": methods,
        "timing_s": {"collect": 92.3, "train": 140.1, "evaluate": 12.4},
        "environment": {"gl_renderer": "llvmpipe", "packages": {"mujoco": "3.17.0"}, "git": "none", "cpu": "2 cores"},
    }


def _write_recording(folder, space, pose, reading, time, wheel_angle, test_pose) -> None:
    some = make_images(test_pose[:4])  # enough of them to tell apart, repeated
    folder.mkdir(parents=True, exist_ok=True)
    save_free_space(folder / "truth" / "free_space.npz", space)
    _write_scene(folder / "scene.glb")
    manifest = {
        "sensors": {"fisheye": "polar_image"},
        "odometry": {"wheel_radius_m": WHEEL_RADIUS_M, "track_m": TRACK_M, "ticks_per_rev": TICKS_PER_REV},
        "settings": {"camera": {"rings": 32, "sectors": 128, "field_of_view_deg": 190.0, "height_m": 0.35}},
    }
    arrays = {
        "observations/fisheye.npy": make_images(pose),
        "reading.npy": reading,
        "time.npy": time,
        "test/fisheye.npy": np.resize(some, (len(test_pose), *some.shape[1:])),
        "truth/pose.npy": pose,
        "truth/reading.npy": reading[:, :2],
        "truth/wheel_angle.npy": wheel_angle,
        "truth/test_pose.npy": test_pose,
    }
    write_files(folder, arrays, manifest)


def make_images(pose: np.ndarray, rings: int = 32, sectors: int = 128) -> np.ndarray:
    """Polar images (..., rings, sectors, 3): lamps on the ceiling and a wall that is red where x is largest."""
    zenith_deg = (np.arange(rings) + 0.5) / rings * 95
    azimuth = pose[..., 2, None] + 2 * np.pi * (np.arange(sectors) + 0.5) / sectors
    radius = 2.2 * np.tan(np.radians(np.minimum(zenith_deg, 89)))
    x = pose[..., 0, None, None] + radius[:, None] * np.cos(azimuth)[..., None, :]
    y = pose[..., 1, None, None] + radius[:, None] * np.sin(azimuth)[..., None, :]
    inside = (np.abs(x) < WIDTH_M / 2) & (np.abs(y) < DEPTH_M / 2)
    lamp = np.exp(-((np.abs(np.mod(x, 2) - 1) ** 2 + np.abs(np.mod(y, 2) - 1) ** 2) * 8))
    wall = np.stack([0.5 + 0.1 * np.clip(x, -5, 5), 0.5 + 0 * x, 0.5 - 0.1 * np.clip(y, -5, 5)], axis=-1)
    ceiling = 0.55 + 0.45 * lamp[..., None]
    return (np.where(inside[..., None], ceiling, np.clip(wall, 0, 1)) * 255).astype(np.uint8)


def _write_scene(path: Path) -> None:
    scene = trimesh.Scene()
    walls = {
        "wall_west": (-WIDTH_M / 2 - 0.05, 0, 0.1, DEPTH_M, 2.6, (225, 220, 210)),
        "wall_east": (WIDTH_M / 2 + 0.05, 0, 0.1, DEPTH_M, 2.6, (225, 220, 210)),
        "wall_south": (0, -DEPTH_M / 2 - 0.05, WIDTH_M + 0.2, 0.1, 2.6, (225, 220, 210)),
        "wall_north": (0, DEPTH_M / 2 + 0.05, WIDTH_M + 0.2, 0.1, 2.6, (225, 220, 210)),
        "floor": (0, 0, WIDTH_M, DEPTH_M, 0.0, (185, 150, 110)),
        "ceiling": (0, 0, WIDTH_M, DEPTH_M, 0.05, (240, 240, 240)),
    }
    for name, (x, y, width, depth, height, colour) in (walls | FURNITURE).items():
        box = trimesh.creation.box((width, depth, max(height, 0.02)))
        z = {"floor": -0.01, "ceiling": 2.625}.get(name, height / 2)
        box.apply_translation((x, y, z))
        box.visual = trimesh.visual.ColorVisuals(box, face_colors=[*colour, 255])
        scene.add_geometry(box, geom_name=name, node_name=name)
    path.write_bytes(bytes(scene.export(file_type="glb")))  # pyright: ignore[reportArgumentType]
