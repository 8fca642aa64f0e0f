"""One sentence on what is wrong in a drive in use."""

from collections.abc import Mapping
from typing import Any

from deepgps.tracking.rules import TITLES


def describe_causes(causes: Mapping[str, Any]) -> str:
    """Describe in a sentence what ``Causes.summarise`` returns."""
    named, refused = causes["named"], causes["refused"]
    parts = [f"{100 * causes['accepted']:.1f} % of images accepted"]
    if refused:
        parts.append(f"refused: {_list_shares(refused)}")
    if suspicious := {name: causes["shares"][name] for name in named if name in causes["shares"]}:
        suspicious = {name: share for name, share in suspicious.items() if share > refused.get(name, 0.0)}
        parts += [f"with those accepted: {_list_shares(suspicious)}"] if suspicious else []
    if "light" in named:
        parts.append(f"pixel values are {causes['gain']:.2f} times those in training")
    if "camera" in named:
        parts.append(f"the camera's lean differs by {causes['lean_deg']:.1f}° from that in training")
    return f"The drive in use: {'; '.join(parts)}."


def _list_shares(shares: Mapping[str, float]) -> str:
    ordered = sorted(shares, key=lambda name: -shares[name])
    return ", ".join(f"{TITLES[name]} {100 * shares[name]:.1f} %" for name in ordered)
