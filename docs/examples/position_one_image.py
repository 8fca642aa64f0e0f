"""Where was this picture taken? A raw fisheye image becomes a polar image, and the polar image a position."""

import cv2
import numpy as np

import deepgps
from deepgps.viewer.pictures import make_warp, warp_round

run = deepgps.simulate("tiny", methods=["deepgps", "knn"], settings={"encoder.step_noise": 0.05})

# A raw image, as of a camera: here it is drawn from a test image of the run.
place, heading, size_px = 5, 0, 480
polar = np.asarray(run.recording.test_observation[place, heading])
rings, sectors, _ = polar.shape
raw = warp_round(polar, make_warp(run.scenario.camera, rings, sectors, size_px))
cv2.imwrite("raw.png", cv2.cvtColor(raw, cv2.COLOR_RGB2BGR))

image = cv2.cvtColor(np.asarray(cv2.imread("raw.png")), cv2.COLOR_BGR2RGB)  # a recording has RGB
centre, radius_px = ((size_px - 1) / 2, (size_px - 1) / 2), size_px / 2
unwrapped = deepgps.unwrap_fisheye(image, centre, radius_px, rings, sectors)
row = place * run.recording.test_observation.shape[1] + heading
truth = run.errors("knn").slice(row, 1).to_pylist()[0]
for method in run.methods:
    x, y = run.position(unwrapped, method)
    print(f"{method}: x {x:.2f} m, y {y:.2f} m; the truth is x {truth['x_m']:.2f} m, y {truth['y_m']:.2f} m")
