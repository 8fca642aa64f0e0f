"""A run as MCAP: images, wheels and poses are those of the run, with their covariance."""

from collections import defaultdict
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rosbags.highlevel import AnyReader

import deepgps
from deepgps.positioner.pose import Poses
from deepgps.robot_io.trajectories import (
    UNKNOWN_VARIANCE_M2,
    UNKNOWN_VARIANCE_RAD2,
    Trajectory,
    find_variances,
    list_poses,
)
from sim.recording.format import open_truth
from sim.recording.manifest import Manifest
from tests.helpers.command import deepgps_here

Messages = dict[str, list[tuple[float, Any]]]


def read(path: Path) -> Messages:
    """Time [s] and message of each topic."""
    found = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, ns, raw in reader.messages():
            found[connection.topic].append((ns / 1e9, reader.deserialize(raw, connection.msgtype)))
    return found


@pytest.fixture(scope="module")
def run(finished_run: Path) -> deepgps.Run:
    return deepgps.load(finished_run)


@pytest.fixture(scope="module")
def messages(run: deepgps.Run, tmp_path_factory: pytest.TempPathFactory) -> Messages:
    folder = tmp_path_factory.mktemp("mcap")
    done = deepgps_here("export", str(run.folder), "--mcap", "--out", "out", cwd=folder)
    assert (done.returncode, done.stdout) == (0, "wrote out/mcap\n"), done.stderr
    return read(folder / "out" / "mcap" / "training.mcap")


def test_images_and_wheels_are_the_recording_s(run, messages):
    recording = run.recording
    seen = messages["/camera/polar/compressed"]
    order = np.argsort(recording.observation_time, kind="stable")
    assert len(seen) == len(order)
    for (time, message), number in list(zip(seen, order, strict=True))[::20]:
        assert time == pytest.approx(recording.observation_time[number], abs=1e-6)
        image = np.array(Image.open(BytesIO(bytes(message.data))))
        np.testing.assert_array_equal(image, recording.observation[number])
    ticks = np.array([message.position for _, message in messages["/joint_states"]]) * 4096 / (2 * np.pi)
    np.testing.assert_allclose(ticks, recording.reading[:, 2:], atol=1e-6)


def test_poses_are_the_run_s_and_the_truth_is_beside_them(run, messages):
    truth = open_truth(run.folder / "recording").pose
    order = np.argsort(run.recording.observation_time, kind="stable")
    placed = np.array([[one.pose.position.x, one.pose.position.y] for _, one in messages["/ground_truth/pose"]])
    np.testing.assert_allclose(placed, truth[order, :2])
    poses = run.pose(run.recording.observation, "deepgps").take(order)
    accepted = np.ones(len(order), bool) if poses.accepted is None else poses.accepted
    for topic, rows in (("/deepgps/pose", accepted), ("/deepgps/refused", ~accepted)):
        told = [one for _, one in messages[topic]]
        assert len(told) == rows.sum()
        assert all(one.header.frame_id == "map" for one in told)
        place = np.array([[one.pose.pose.position.x, one.pose.pose.position.y] for one in told]).reshape(-1, 2)
        np.testing.assert_allclose(place, poses.position[rows], atol=1e-9)
        variance = np.array([one.pose.covariance.reshape(6, 6).diagonal()[[0, 1, 5]] for one in told]).reshape(-1, 3)
        np.testing.assert_allclose(variance, find_variances(poses)[rows])


def test_what_is_not_known_has_a_large_variance_and_refused_poses_a_topic_of_their_own():
    bare = Poses(np.zeros((2, 2)), yaw=np.array([np.nan, 1.0]), yaw_std=np.array([np.nan, 0.1]))
    expected = [
        [UNKNOWN_VARIANCE_M2, UNKNOWN_VARIANCE_M2, UNKNOWN_VARIANCE_RAD2],
        [UNKNOWN_VARIANCE_M2, UNKNOWN_VARIANCE_M2, 0.01],
    ]
    np.testing.assert_allclose(find_variances(bare), expected)
    circle = Poses(np.zeros((1, 2)), radius_68=np.array([2.0]))
    drawn = np.sqrt(find_variances(circle)[0, 0]) * np.random.default_rng(0).standard_normal((100_000, 2))
    assert (np.hypot(*drawn.T) < 2.0).mean() == pytest.approx(0.68, abs=0.005)
    one = Trajectory("training", "knn", np.arange(2.0), replace(bare, accepted=np.array([True, False])))
    good, refused = list_poses(one, 5)
    assert (good.name, refused.name) == ("/knn/pose", "/knn/refused")
    assert refused.logged.tolist() == [10**9 + 5]
    assert refused.make(0).header.stamp.sec == 1
    assert good.make(0).pose.pose.orientation.w == 1.0


def test_times_count_from_the_beginning_of_an_imported_log(run):
    assert run.recording.manifest.start_ns == 0
    values = run.recording.manifest.model_dump(by_alias=True)
    for written, read in ((7, 7), ("x", 0), ([1], 0), (None, 0)):
        assert Manifest.model_validate({**values, "log": {"start_ns": written}}).start_ns == read
