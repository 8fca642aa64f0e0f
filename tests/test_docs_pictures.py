"""The pictures of the pages are drawn from runs by scripts, which must keep up with the code."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from docs import pictures
from docs.explore_picture import draw_drive
from sim.recording.format import open_truth


@pytest.mark.slow
def test_the_pictures_of_concepts_are_drawn_from_a_run(finished_run: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(pictures, "PICTURES", tmp_path)
    pictures.draw_all(finished_run)
    drawn = {path.stem: np.asarray(cv2.imread(str(path))) for path in tmp_path.glob("*.png")}
    assert set(drawn) == {"camera", "segments", "straightness", "map", "fold", "error_field"}
    assert all(picture.std() > 10 for picture in drawn.values())


def test_the_picture_of_exploring_is_drawn_from_a_drive(finished_run: Path):
    assert len(draw_drive(open_truth(finished_run / "recording")).axes) == 3
