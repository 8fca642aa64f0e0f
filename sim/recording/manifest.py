"""The manifest: a recording's metadata, checked once when it is opened."""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from sim import renamed

SCHEMA = 2
READ = (1, 2)
"""Schemas that can be read; schema 1 had other names, and one sensor without a name."""
ObservationKind = Literal["polar_image", "scan", "vector", "image"]
"""polar_image: fisheye images around the zenith; scan: a lidar's distances; vector: distances to landmarks;
image: any other picture, which no method learns from."""
_SENSOR_OF = {"landmarks": ("landmarks", "vector"), "obstacles": ("lidar", "scan")}


class Manifest(BaseModel):
    """Metadata of a recording; a writer may add keys of its own.

    Attributes:
        number: Number of the schema.
        sensors: Kind of each sensor's observations, by its name; methods learn from the first.
        settings: Settings of the simulation, if there was one.
        seed: Seed of the simulation.
        samples: Number of observations of the first sensor.
        segments: Number of straight segments driven.
        readings_lost: Number of encoder readings that never arrived.
        distance_driven_m: Distance travelled along all segments [m].
        odometry: What is known of the wheels; ``sim.sensors.encoder.check_odometry`` checks it.
        gl_renderer: Name of the renderer of the images.
        sha256: Checksum of each file, by its path in the folder.
    """

    model_config = ConfigDict(frozen=True, extra="allow", populate_by_name=True)

    number: int = Field(default=SCHEMA, alias="schema")
    sensors: dict[str, ObservationKind] = Field(default_factory=dict)
    settings: dict[str, Any] = Field(default_factory=dict)
    seed: int | None = None
    samples: int | None = None
    segments: int | None = None
    readings_lost: int = 0
    distance_driven_m: float | None = None
    odometry: dict[str, Any] = Field(default_factory=dict)
    gl_renderer: str = "none"
    sha256: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _by_todays_names(cls, values: Any) -> Any:
        if not isinstance(values, Mapping) or values.get("schema") != 1:
            return values
        settings = renamed.translate(values.get("settings", {}))
        constants = {renamed.name_now(f"encoder.{name}"): value for name, value in values.get("odometry", {}).items()}
        odometry = {str(name).removeprefix("encoder."): value for name, value in constants.items()}
        return {**values, "settings": settings, "odometry": odometry, "sensors": name_sensors(settings)}

    @property
    def sensor(self) -> str:
        """The sensor that methods learn from; empty if the manifest names none."""
        return next(iter(self.sensors), "")

    @property
    def kind(self) -> ObservationKind | None:
        """Kind of the observations that methods learn from; None if the manifest names no sensor."""
        return next(iter(self.sensors.values()), None)


def name_sensors(settings: Mapping[str, Any]) -> dict[str, str]:
    """Sensors and their kinds for the settings of a simulation, as in a manifest."""
    world, sensor = settings.get("world", "room"), settings.get("sensor", "fisheye")
    name, kind = _SENSOR_OF.get(world, ("lidar", "scan") if sensor == "lidar" else ("fisheye", "polar_image"))
    tags = settings.get("tag_camera", {}).get("kept", False)
    return {name: kind, **({"tag_camera": "image"} if tags else {})}
