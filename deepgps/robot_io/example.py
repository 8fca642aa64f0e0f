"""Poses of raw fisheye images or polar images, without torch and deepgps: python example.py IMAGE [IMAGE ...]"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import onnxruntime


class Locator:
    """Finds poses with the files of an exported folder."""

    def __init__(self, folder: Path = Path(__file__).parent) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.model = onnxruntime.InferenceSession(str(folder / "model.onnx"), options)
        self.meta, self.tables = json.loads((folder / "meta.json").read_text()), dict(np.load(folder / "tables.npz"))

    def locate(self, image: np.ndarray) -> dict[str, np.ndarray]:
        """The outputs that meta.json describes, of a raw image or a polar image (rings, sectors, 3), RGB uint8."""
        shape, tables = tuple(self.meta["image"]), self.tables
        if image.shape != shape:
            image = cv2.remap(image, tables["raw_column"], tables["raw_row"], cv2.INTER_LINEAR)
            image = cv2.resize(image, shape[1::-1], interpolation=cv2.INTER_AREA)
        if "lean_column" in tables:
            padded = image.reshape(-1, 3)[tables["lean_pixel"]]
            image = cv2.remap(padded, tables["lean_column"], tables["lean_row"], cv2.INTER_LANCZOS4)
        found = self.model.run(None, {"image": image[None]})
        return {one.name: np.asarray(part)[0] for one, part in zip(self.model.get_outputs(), found, strict=True)}


if __name__ == "__main__":
    locator = Locator()
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    for name in sys.argv[1:]:
        pose = locator.locate(cv2.cvtColor(np.asarray(cv2.imread(name, flags)), cv2.COLOR_BGR2RGB))
        print(name, {part: value.tolist() for part, value in pose.items()})
