"""A training drive during which the light changes."""

from sim.settings import DeploymentSettings, SimSettings

STATES = (
    DeploymentSettings(),
    DeploymentSettings(daylight=0.3),
    DeploymentSettings(daylight=1.0, lamps=0.0),
    DeploymentSettings(daylight=0.0),
)
"""Light of consecutive parts of the drive, in turn: as usual, little daylight, lamps off, night."""


def light_part(settings: SimSettings, number: int) -> SimSettings:
    """Settings of what is sensed in the drive's part with a number, which are the drive's if the light is constant."""
    if not settings.drive.mixed_light:
        return settings
    return settings.model_copy(update={"deployment": STATES[number % len(STATES)]})
