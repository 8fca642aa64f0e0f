"""Settings of the robot's body and its wheel encoders."""

from collections.abc import Mapping
from typing import Any

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from sim.plugins import ENCODER_FAULTS, HOW_TO_LOAD
from sim.settings.group import Group, WithPlugins
from sim.user_input import shorten

NAMES_OF_OWN = ("left_joint", "right_joint", "camera_site")
"""Settings that name parts of a user's own robot."""


class RobotSettings(Group):
    """The robot's body: a fault of its left wheel, or a robot of your own."""

    wheel_radius_error: float = Field(default=0.0, ge=-0.2, le=0.2)
    """The left wheel of the model itself is larger by this fraction, so the robot drives curves."""
    mjcf: str | None = Field(default=None, max_length=4096, pattern=r"^[^\x00]*$")
    """Your own robot: path of an MJCF file."""
    left_joint: str = "left_wheel"
    """Name of its left wheel's joint."""
    right_joint: str = "right_wheel"
    """Name of its right wheel's joint."""
    camera_site: str = "camera"
    """Name of the site of its camera, which looks along the site's z axis."""

    @model_serializer(mode="wrap")
    def _write_own_robot_only_if_there_is_one(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        own = ("mjcf", *NAMES_OF_OWN)
        return {name: value for name, value in write(self).items() if name not in own or self.mjcf is not None}

    @model_validator(mode="after")
    def _only_our_wheel_can_be_scaled(self) -> "RobotSettings":
        if self.mjcf is not None and self.wheel_radius_error:
            raise ValueError(f"wheel_radius_error {self.wheel_radius_error:g} must be 0 with a robot of your own")
        return self

    @model_validator(mode="after")
    def _only_an_own_robot_has_names(self) -> "RobotSettings":
        for name in NAMES_OF_OWN if self.mjcf is None else ():
            if (value := getattr(self, name)) != RobotSettings.model_fields[name].default:
                raise ValueError(f"{name} {shorten(value)} names a part of a robot of your own, and needs mjcf")
        return self


class FaultSetting(Group):
    """Strength of a fault that a plugin defines, and the checksum of the plugin's source."""

    value: float
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class EncoderSettings(WithPlugins):
    """The wheel encoders and their faults; all but the first are faults of measurement."""

    ticks_per_rev: int = Field(default=4096, ge=4, le=65536)
    """Ticks per wheel revolution (TurtleBot3: 4096)."""
    radius_error_left: float = Field(default=0.0, ge=-0.5, le=0.5)
    """The left wheel's assumed radius is wrong by this fraction; its distances scale with 1 + the fraction."""
    radius_error_right: float = Field(default=0.0, ge=-0.5, le=0.5)
    """The right wheel's assumed radius is wrong by this fraction."""
    track_error: float = Field(default=0.0, ge=-0.5, le=0.5)
    """The assumed track width is wrong by this fraction (turns only)."""
    slip_per_m: float = Field(default=0.0, ge=0.0, le=0.5)
    """Standard deviation of each wheel's slip after a metre [m]; it grows with the root of the distance travelled."""
    step_noise: float = Field(default=0.0, ge=0.0, le=1.0)
    """The paper's w: each gap between readings is multiplied by 1 + w n, n standard normal."""
    dropout: float = Field(default=0.0, ge=0.0, le=0.9)
    """Fraction of readings that never arrive."""
    stuck_fraction: float = Field(default=0.0, ge=0.0, le=0.9)
    """Fraction of the readings, in one stretch, during which one random encoder, left or right, counts nothing."""
    plugins: dict[str, FaultSetting] = Field(default_factory=dict)
    """Faults that plugins define: their strengths by name."""

    @field_validator("plugins", mode="before")
    @classmethod
    def _add_the_checksums(cls, given: Any) -> Any:
        return {name: _add_checksum(name, value) for name, value in given.items()} if _is_mapping(given) else given

    @field_validator("plugins")
    @classmethod
    def _leave_out_what_is_off(cls, plugins: dict[str, FaultSetting]) -> dict[str, FaultSetting]:
        for name, setting in plugins.items():
            low, high = ENCODER_FAULTS[name].limits if name in ENCODER_FAULTS else (-float("inf"), float("inf"))
            if setting.value and not low <= setting.value <= high:
                raise ValueError(f"{shorten(name)} {setting.value}: must be from {low:g} to {high:g}, or 0")
        return {name: plugins[name] for name in sorted(plugins) if plugins[name].value}


def _add_checksum(name: str, value: Any) -> Any:
    """A fault's setting with the checksum of the loaded plugin's source, unless it holds one."""
    if isinstance(value, FaultSetting) or (_is_mapping(value) and "sha256" in value):
        return value  # of a run or a recording, which can be opened without the plugin
    if name not in ENCODER_FAULTS:
        raise ValueError(f"no plugin that is loaded defines {shorten(str(name))}; {HOW_TO_LOAD}")
    source = ENCODER_FAULTS[name].source
    given = dict(value) if _is_mapping(value) else {"value": value}
    return {**given, "sha256": source.sha256 if source else ""}


def _is_mapping(value: Any) -> bool:
    return isinstance(value, Mapping)
