"""Poses of raw fisheye images or polar images, without torch and deepgps: python example.py IMAGE [IMAGE ...]"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
from kriging import Kernel  # pyright: ignore[reportMissingImports]
from pixels import KnownPixels, grey  # pyright: ignore[reportMissingImports]
from registration import (  # pyright: ignore[reportMissingImports]
    REASONS,
    Calibration,
    Registration,
    subtract_mount,
)


class Locator:
    """Finds poses with the files of an exported folder."""

    def __init__(self, folder: Path = Path(__file__).parent) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.model = onnxruntime.InferenceSession(str(folder / "model.onnx"), options)
        self.meta, self.tables = json.loads((folder / "meta.json").read_text()), dict(np.load(folder / "tables.npz"))
        self.known, meta, tables = None, self.meta["map"], self.tables
        if meta is not None:
            pixels = KnownPixels(tables["images"], tables["noise"], meta["heading"]) if "images" in tables else None
            kernel, calibration = Kernel(*meta["kernel"]), Calibration(**meta["calibration"])
            arrays = tables["known"], tables["places"], tables["place_std"]
            self.known = Registration(*arrays, kernel, calibration, pixels, meta["chirality"])

    def locate(self, image: np.ndarray) -> dict[str, np.ndarray]:
        """What meta.json describes, of a raw image or a polar image (rings, sectors, 3), RGB uint8."""
        shape, tables = tuple(self.meta["image"]), self.tables
        if image.shape != shape:
            image = cv2.remap(image, tables["raw_column"], tables["raw_row"], cv2.INTER_LINEAR)
            image = cv2.resize(image, shape[1::-1], interpolation=cv2.INTER_AREA)
        if "lean_column" in tables:
            padded = image.reshape(-1, 3)[tables["lean_pixel"]]
            image = cv2.remap(padded, tables["lean_column"], tables["lean_row"], cv2.INTER_LANCZOS4)
        names = [one.name for one in self.model.get_outputs()]
        found = dict(zip(names, map(np.asarray, self.model.run(None, {"image": image[None]})), strict=True))
        rotation, shift = np.array(self.meta["rotation"]), np.array(self.meta["translation"])
        if self.known is None:
            return {"position": found["position"][0] @ rotation.T + shift}
        pose = self.known.register(found["features"], grey(image[None]))
        if "position" in found:
            pose = pose.move(found["position"].astype(float), self.known.calibration.difference)
        radius = self.known.find_radii(pose)[0]
        axle = subtract_mount(pose.position, pose.yaw, self.meta["mount_m"], self.known.chirality < 0)
        yaw = np.arctan2(*rotation[::-1, 0]) + np.linalg.det(rotation) * pose.yaw
        return {
            "position": axle[0] @ rotation.T + shift,
            "yaw": (yaw[0] + np.pi) % (2.0 * np.pi) - np.pi,
            "yaw_std": pose.yaw_std[0],
            "radius_68": radius[0],
            "radius_95": radius[1],
            "covariance": rotation @ pose.covariance[0] @ rotation.T,
            "accepted": pose.reason[0] == 0,
            "reason": REASONS[pose.reason[0]],
        }


if __name__ == "__main__":
    locator = Locator()
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    for name in sys.argv[1:]:
        pose = locator.locate(cv2.cvtColor(np.asarray(cv2.imread(name, flags)), cv2.COLOR_BGR2RGB))
        print(name, {part: np.asarray(value).tolist() for part, value in pose.items()})
