"""Laws of the table of sensors."""

from sim.recording.manifest import name_sensors
from sim.sensors.catalog import SENSORS, list_carried, load
from sim.settings import SimSettings, TagCameraSettings


def test_every_function_of_a_record_exists():
    for sensor in SENSORS.values():
        functions = [sensor.open, sensor.mount, sensor.make_measures, sensor.extract]
        assert all(callable(load(function)) for function in functions if function)


def test_one_sensor_is_carried_for_methods_to_learn_from():
    for settings, first in (
        (SimSettings(), "fisheye"),
        (SimSettings(sensor="lidar"), "lidar"),
        (SimSettings(world="obstacles"), "lidar"),
        (SimSettings(world="landmarks", sensor="lidar"), "landmarks"),
    ):
        assert list_carried(settings) == list(name_sensors(settings)) == [first]
        if settings.world == "room":
            assert SENSORS[first].open, "a room has it rendered or cast"
            tags = settings.model_copy(update={"tag_camera": TagCameraSettings(mounted=True)})
            assert (list_carried(tags), list(name_sensors(tags))) == ([first, "tag_camera"], [first])
