from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from sim.recording import chunks
from sim.recording.collect import collect
from sim.recording.format import open_recording
from sim.recording.manifest import STATES, choose_drive_in_use, light_part
from sim.settings import CameraSettings, DriveSettings, GridSettings, RoomSettings, SimSettings

SMALL = SimSettings(
    room=RoomSettings(kind="bedroom", width_m=3.6, depth_m=3.2, seed=3),
    camera=CameraSettings(rings=8, sectors=32, face_px=16),
    drive=DriveSettings(samples=60, longest_m=0.5),
    grid=GridSettings(spacing_m=1.0, headings=1),
)


def quiet(label: str, done: int, total: int) -> None:
    pass


def mixed(settings: SimSettings) -> SimSettings:
    return settings.model_copy(update={"drive": settings.drive.model_copy(update={"mixed_light": True})})


@pytest.mark.slow
def test_the_same_drive_is_seen_in_changing_light(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(chunks, "CHUNK", 16)
    collect(SMALL, 0, tmp_path / "plain", quiet, workers=1)
    collect(mixed(SMALL), 0, tmp_path / "mixed", quiet, workers=1)
    plain, changing = open_recording(tmp_path / "plain"), open_recording(tmp_path / "mixed")
    assert np.array_equal(plain.reading, changing.reading)
    same = (plain.observation == changing.observation).all(axis=(1, 2, 3))
    assert same[:16].all() and 0.1 < same.mean() < 0.6
    assert np.array_equal(plain.test_observation, changing.test_observation)  # tests are in the light of use


def test_light_takes_turns():
    lit = [light_part(mixed(SMALL), number).deployment for number in range(6)]
    assert lit == [*STATES, *STATES[:2]]
    assert light_part(SMALL, 1) is SMALL
    assert not choose_drive_in_use(mixed(SMALL)).drive.mixed_light


def test_settings_of_mixed_light_are_read_as_written():
    assert SimSettings.model_validate(mixed(SMALL).model_dump(mode="json")) == mixed(SMALL)


def test_only_a_room_with_a_camera_has_light():
    with pytest.raises(ValidationError, match=r"drive\.mixed_light needs world room and sensor fisheye"):
        SimSettings(sensor="lidar", drive=DriveSettings(mixed_light=True))
    with pytest.raises(ValidationError, match="deployment changes what a camera sees"):
        SimSettings.model_validate({"sensor": "lidar", "deployment": {"person": True}})
