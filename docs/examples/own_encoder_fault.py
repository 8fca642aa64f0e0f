"""An encoder fault of one's own: the wheels warm up and grow, so the encoders count too little, more and more.

As a plugin: deepgps run tiny --plugin own_encoder_fault.py --encoder.plugins.warming 0.02
"""

import numpy as np

import deepgps


def warm_up(angle: np.ndarray, growth: float, wheel_radius_m: float, rng: np.random.Generator) -> np.ndarray:
    """Wheel angles (R, 2) [rad] of wheels that grow evenly during the drive, at last by the fraction ``growth``."""
    grown = 1.0 + growth * np.linspace(0.0, 1.0, len(angle) - 1)[:, None]
    return np.concatenate([angle[:1], angle[:1] + np.cumsum(np.diff(angle, axis=0) / grown, axis=0)])


def expect_bias(growth: float, length_m: np.ndarray) -> np.ndarray:
    """Mean squared error [m^2] of segments of these lengths, spread evenly over the drive."""
    return (growth * length_m) ** 2 / 3.0


ENCODER_FAULTS = {
    "warming": deepgps.EncoderFault(
        "growth of the wheels during the drive", apply=warm_up, bias=expect_bias, limits=(0.0, 0.5)
    )
}

if __name__ == "__main__":
    for growth in (0.0, 0.1):
        run = deepgps.simulate("tiny", settings={"encoder.plugins.warming": growth}, plugins=[__file__])
        print(f"growth {growth:.0%}: segments wrong by {1000 * run.metrics['distances']['segment_rms_m']:.1f} mm RMS")
