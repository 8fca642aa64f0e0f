"""Laws of the yaw of one image, on images that are drawn by formula for any pose."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from deepgps.positioner.heading_fit import CELL_M, fit_lines, make_headings
from deepgps.positioner.headings import HeadingTable, Yaws
from sim.alignment import fit_alignment
from sim.geometry import wrap
from sim.recording.format import Recording, open_recording, write_files
from tests.helpers.synthetic_run import make_drive, make_free_space, make_images

RINGS, SECTORS = 16, 64
ODOMETRY = {"wheel_radius_m": 0.033, "track_m": 0.16, "ticks_per_rev": 4096}


def record(folder: Path, camera: np.ndarray, pose: np.ndarray, reading: np.ndarray, time: np.ndarray) -> Recording:
    """The drive of an axle with these poses (N, 3), seen by a camera at other poses."""
    arrays = {
        "observations/fisheye.npy": make_images(camera, RINGS, SECTORS),
        "reading.npy": reading,
        "time.npy": time,
        "test/fisheye.npy": make_images(pose[:1, None], RINGS, SECTORS),
    }
    write_files(folder, arrays, {"sensors": {"fisheye": "polar_image"}, "odometry": ODOMETRY})
    return open_recording(folder)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, np.ndarray]:
    """A drive in the synthetic room and its true poses (N, 3)."""
    pose, reading, time, _ = make_drive(make_free_space(), 900, np.random.default_rng(0))
    return record(tmp_path_factory.mktemp("headings") / "recording", pose, pose, reading, time), pose


@pytest.fixture(scope="module")
def table(drive: tuple[Recording, np.ndarray]) -> HeadingTable:
    made = make_headings(drive[0], drive[1][:, :2])
    assert made is not None
    return made


@cache
def draw_queries(count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Poses (n, 3) anywhere on the floor, and their images."""
    rng, space = np.random.default_rng(1), make_free_space()
    place = rng.uniform((-3.2, -1.9), (3.2, 1.9), (20 * count, 2))
    place = place[space.is_reachable(place)][:count]
    pose = np.column_stack([place, rng.uniform(-np.pi, np.pi, len(place))])
    return pose, make_images(pose, RINGS, SECTORS)


def find(table: HeadingTable, images: np.ndarray, place: np.ndarray) -> Yaws:
    return table.find(images, place)


def degrees_off(found: Yaws, yaw: np.ndarray) -> np.ndarray:
    return np.degrees(np.abs(wrap(found.yaw[:, 0] - yaw)))


def test_the_yaw_is_right_and_its_standard_deviation_too(table: HeadingTable) -> None:
    pose, images = draw_queries()
    found = find(table, images, pose[:, :2])
    error = degrees_off(found, pose[:, 2])
    assert np.median(error) < 1.0
    assert np.percentile(error, 90) < 4.0
    assert 0.3 < np.median(error / np.degrees(found.std[:, 0])) / 0.6745 < 2.0
    assert (found.weight[:, 0] >= found.weight[:, 1]).all() and (found.weight.sum(axis=1) <= 1.0 + 1e-6).all()


@pytest.mark.parametrize("sectors", [1, 5, -17, 32])
def test_turning_by_sectors_turns_the_yaw_by_exactly_that(table: HeadingTable, sectors: int) -> None:
    pose, images = draw_queries()
    there = find(table, images, pose[:, :2])
    turned = find(table, np.roll(images, -sectors, axis=2), pose[:, :2])
    assert np.abs(wrap(turned.yaw - there.yaw - 2 * np.pi * sectors / SECTORS))[there.weight > 0].max() < 1e-5
    assert np.allclose(turned.std[:, 0], there.std[:, 0], atol=1e-6)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_rigid_motion_of_the_map_changes_no_yaw_in_the_world(
    drive: tuple[Recording, np.ndarray], table: HeadingTable, mirror: float
) -> None:
    recording, pose = drive
    motion = np.array([[0.6, -0.8], [0.8, 0.6]]) * [1.0, mirror]
    moved = pose[:, :2] @ motion.T + [3.0, -2.0]
    alignment = fit_alignment(moved, pose[:, :2], "E2")
    # the cells of a map that is moved hold other images, so the table itself is moved
    angle = np.arctan2(*(motion @ [np.cos(table.heading), np.sin(table.heading)])[::-1])
    other = replace(
        table,
        place=table.place @ motion.T + [3.0, -2.0],
        heading=angle,
        parallax=mirror * table.parallax @ motion.T,
        chirality=int(mirror) * table.chirality,
    )
    test, images = draw_queries()
    here = find(table, images, test[:, :2])
    there = find(other, images, test[:, :2] @ motion.T + [3.0, -2.0])
    sure = here.weight[:, 0] > 0.8
    assert np.abs(wrap(alignment.turn(there.yaw[:, 0]) - here.yaw[:, 0]))[sure].max() < 1e-4
    made = make_headings(recording, moved)
    assert made is not None
    assert made.chirality == mirror == mirror * table.chirality
    error = np.degrees(
        np.abs(wrap(alignment.turn(find(made, images, test[:, :2] @ motion.T + [3.0, -2.0]).yaw[:, 0]) - test[:, 2]))
    )
    assert np.median(error) < 1.0
    assert np.percentile(error, 90) < 4.0


def test_a_place_with_twofold_symmetry_has_two_hypotheses(drive: tuple[Recording, np.ndarray]) -> None:
    recording, pose = drive
    images = np.asarray(recording.observation, float)
    twofold = (images + np.roll(images, SECTORS // 2, axis=2)) / 2
    table = make_headings(replace(recording, observation=twofold), pose[:, :2])
    assert table is not None
    test, seen = draw_queries()
    seen = (seen + np.roll(seen.astype(float), SECTORS // 2, axis=2)) / 2
    found = find(table, seen, test[:, :2])
    assert np.allclose(found.weight[:, 0], found.weight[:, 1], atol=0.02)
    assert np.allclose(np.abs(wrap(found.yaw[:, 0] - found.yaw[:, 1])), np.pi, atol=np.radians(3.0))
    assert np.median(found.weight) > 0.49
    nearer = np.abs(wrap(found.yaw - test[:, 2:])).min(axis=1)
    assert np.degrees(np.median(nearer)) < 1.0


def test_light_changes_nothing(table: HeadingTable) -> None:
    pose, images = draw_queries()
    plain, lit = (find(table, one, pose[:, :2]) for one in (images.astype(float), 0.4 * images + 20.0))
    assert np.abs(wrap(plain.yaw[:, 0] - lit.yaw[:, 0])).max() < 1e-5


def test_a_blank_image_has_no_yaw_and_blank_images_make_no_table(
    drive: tuple[Recording, np.ndarray], table: HeadingTable
) -> None:
    rings = np.broadcast_to(np.arange(RINGS, dtype=np.uint8)[:, None, None], (RINGS, SECTORS, 3))
    found = find(table, np.stack([np.full_like(rings, 80), rings, np.zeros_like(rings)]), np.zeros((3, 2)))
    assert np.isnan(found.yaw).all() and np.isnan(found.std).all() and not found.weight.any()
    assert find(table, np.zeros((0, RINGS, SECTORS, 3), np.uint8), np.zeros((0, 2))).yaw.shape == (0, 2)
    recording, pose = drive
    blank = replace(recording, observation=np.full_like(recording.observation, 90))
    assert make_headings(blank, pose[:, :2]) is None


def test_the_table_grows_with_the_area_and_not_with_the_images(
    drive: tuple[Recording, np.ndarray], table: HeadingTable
) -> None:
    recording, pose = drive
    twice = replace(recording, observation=np.tile(recording.observation, (2, 1, 1, 1)))
    reading = recording.reading.copy()
    reading[:, :2] += reading[-1, :2] + 1
    twice = replace(twice, reading=np.concatenate([recording.reading, reading]))
    more = make_headings(twice, np.tile(pose[:, :2], (2, 1)))
    assert more is not None and len(more.place) == len(table.place)
    assert len(np.unique(np.floor(table.place / CELL_M), axis=0)) == len(table.place)


def test_one_image_at_a_time_gives_what_many_give_and_packing_keeps_every_bit(table: HeadingTable) -> None:
    pose, images = draw_queries()
    many, packed = (find(one, images, pose[:, :2]) for one in (table, HeadingTable.unpack(*table.pack())))
    for one, other in zip(vars(many).values(), vars(packed).values(), strict=True):
        assert np.array_equal(one, other, equal_nan=True)
    for row in range(0, len(pose), 37):
        one = find(table, images[row : row + 1], pose[row : row + 1, :2])
        assert abs(wrap(one.yaw[0, 0] - many.yaw[row, 0])) < 1e-5
        assert np.allclose(one.weight[0], many.weight[row], atol=1e-4)


def test_lines_leave_out_the_images_of_two_segments(drive: tuple[Recording, np.ndarray]) -> None:
    recording, pose = drive
    lines = fit_lines(recording, pose[:, :2])
    uses = np.bincount(recording.reading[:, 1], minlength=len(pose))
    known = np.isfinite(lines.heading)
    assert not known[uses > 1].any() and known.mean() > 0.5
    assert np.abs(wrap(lines.heading - pose[:, 2]))[known].max() < 1e-3
