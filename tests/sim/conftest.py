"""What tests of the simulator share: each room is built once, however many worlds stand in it."""

from collections.abc import Iterator
from functools import lru_cache

import pytest

from sim.rooms.build import build_room


@pytest.fixture(autouse=True, scope="package")
def rooms_built_once() -> Iterator[None]:
    build_once = lru_cache(maxsize=4)(build_room)
    with pytest.MonkeyPatch.context() as patch:
        for module in ("sim.robot.world", "sim.sensors.lidar", "sim.sensors.camera.fisheye_images"):
            patch.setattr(f"{module}.build_room", lambda settings: build_once(settings).copy())
        yield
