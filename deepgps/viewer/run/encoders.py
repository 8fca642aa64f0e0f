"""The encoders: the dead-reckoned path below ``world/reckoned``, the encoders' errors below ``encoders``."""

from io import BytesIO

import numpy as np
import rerun as rr

from deepgps.evaluation.segment_errors import measure_segments, reckon_path
from deepgps.reports import style
from deepgps.reports.wheels_page import describe_encoders, draw_segments
from deepgps.viewer.run.drive import WRONG, Colour, log_path
from deepgps.viewer.scene import LAYER_M, lift
from deepgps.viewer.timeline import drive_index, send_series
from sim.recording.format import Recording, Truth

ENCODER: Colour = (255, 150, 40)


def log_encoders(stream: rr.RecordingStream, recording: Recording, truth: Truth) -> None:
    """Log the dead-reckoned path, its distance from the true path, and the errors of segments as text and figure."""
    true, reckoned = truth.pose[recording.reading[:, 1], :2], reckon_path(recording, truth.pose)
    drift = np.linalg.norm(reckoned - true, axis=1)
    indexes = drive_index(recording.time, recording)
    log_path(stream, "world/reckoned", reckoned, (ENCODER, ENCODER), recording)
    stream.log("world/reckoned/place", rr.Points3D.from_fields(radii=0.06, colors=ENCODER), static=True)
    stream.send_columns("world/reckoned/place", indexes, rr.Points3D.columns(positions=lift(reckoned, 5 * LAYER_M)))
    stream.log("world/reckoned/drift", rr.LineStrips3D.from_fields(radii=0.012, colors=WRONG), static=True)
    ends = np.stack([lift(true, 4 * LAYER_M), lift(reckoned, 4 * LAYER_M)], axis=1)
    stream.send_columns("world/reckoned/drift", indexes, rr.LineStrips3D.columns(strips=ends))
    send_series(stream, "encoders/drift", indexes, drift, "dead-reckoning drift", WRONG)
    text = describe_encoders(recording, truth.pose, drift)
    stream.log("encoders/faults", rr.TextDocument(text, media_type="text/markdown"), static=True)
    picture = style.to_png(draw_segments(*measure_segments(recording, truth.pose)))
    image = rr.EncodedImage(contents=BytesIO(picture), media_type="image/png")
    stream.log("encoders/segments", image, static=True)
