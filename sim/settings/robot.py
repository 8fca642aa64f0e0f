"""Settings of the robot's body and its wheel encoders."""

from typing import Any

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer, model_validator

from sim.errors import shorten
from sim.plugins import ENCODER_FAULTS
from sim.settings.group import Group

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


class EncoderSettings(Group):
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
    plugins: dict[str, float] = Field(default_factory=dict, exclude_if=lambda faults: not faults)
    """Strengths of the faults that plugins define, by name; a fault of strength 0 is left out."""

    def __hash__(self) -> int:
        return hash(self.model_dump_json())  # a dictionary has no hash

    @field_validator("plugins")
    @classmethod
    def _leave_out_what_is_off(cls, plugins: dict[str, float]) -> dict[str, float]:
        """A fault whose plugin is not loaded passes, since recordings with it can be read; driving refuses it."""
        for name, strength in plugins.items():
            low, high = ENCODER_FAULTS[name].limits if name in ENCODER_FAULTS else (-float("inf"), float("inf"))
            if strength and not low <= strength <= high:
                raise ValueError(f"{shorten(name)} {strength}: must be from {low:g} to {high:g}, or 0")
        return {name: plugins[name] for name in sorted(plugins) if plugins[name]}
