"""Learn positions from images and distances driven, evaluate what was learned, and show it.

The names below are imported when they are first used, so that ``import deepgps`` takes no time.
"""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepgps.api.record import write_recording as write_recording
    from deepgps.api.run import Run as Run
    from deepgps.api.run import load as load
    from deepgps.api.simulate import simulate as simulate
    from deepgps.api.simulate import train as train
    from deepgps.config.methods import Method as Method
    from deepgps.config.scenario import Scenario as Scenario
    from deepgps.positioner.positioner import Fitted as Fitted
    from sim.errors import InputError as InputError
    from sim.errors import WorkError as WorkError
    from sim.geometry import FreeSpace as FreeSpace
    from sim.plugins import EncoderFault as EncoderFault
    from sim.sensors.camera.lens import Lens as Lens
    from sim.sensors.camera.unwrap import unwrap_fisheye as unwrap_fisheye

    __version__: str

_HOMES = {
    "deepgps.api.record": ("write_recording",),
    "deepgps.api.run": ("Run", "load"),
    "deepgps.api.simulate": ("simulate", "train"),
    "deepgps.config.methods": ("Method",),
    "deepgps.config.scenario": ("Scenario",),
    "deepgps.positioner.positioner": ("Fitted",),
    "sim.errors": ("InputError", "WorkError"),
    "sim.geometry": ("FreeSpace",),
    "sim.plugins": ("EncoderFault",),
    "sim.sensors.camera.lens": ("Lens",),
    "sim.sensors.camera.unwrap": ("unwrap_fisheye",),
}
"""Names of the Python interface by module."""
_HOME = {name: module for module, names in _HOMES.items() for name in names}
__all__ = [*_HOME, "__version__"]  # noqa: PLE0604  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("deepgps")
    if name not in _HOME:
        raise AttributeError(f"module 'deepgps' has no attribute {name!r}")
    value = resolve_name(f"{_HOME[name]}:{name}")
    globals()[name] = value  # the next use finds it at once
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
