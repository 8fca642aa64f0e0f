import cv2
import numpy as np
import pytest

from sim.settings import RoomSettings
from sim.tools import gallery
from sim.tools.gallery import draw_gallery, draw_room, lay_out


def test_a_row_shows_the_room_from_a_corner_from_above_and_as_the_camera_sees_it():
    row = draw_room(RoomSettings(kind="bedroom", shape="l", seed=1))
    columns = gallery.PERSPECTIVE_PX + gallery.TOP_VIEW_PX + gallery.ROW_PX + gallery.POLAR_PX + 4 * gallery.MARGIN_PX
    assert row.shape == (gallery.ROW_PX + gallery.MARGIN_PX + gallery.LABEL_PX, columns, 3)
    left = gallery.MARGIN_PX
    for width in (gallery.PERSPECTIVE_PX, gallery.TOP_VIEW_PX, gallery.ROW_PX, gallery.POLAR_PX):
        part = row[gallery.LABEL_PX + gallery.MARGIN_PX :, left : left + width]
        assert part.std() > 25.0
        assert len(np.unique(part.reshape(-1, 3), axis=0)) > 500
        left += width + gallery.MARGIN_PX
    # An L-shaped room leaves a corner of the top view empty, and the start is a red dot in it.
    start = gallery.PERSPECTIVE_PX + 2 * gallery.MARGIN_PX
    top = row[gallery.LABEL_PX + gallery.MARGIN_PX :, start : start + gallery.TOP_VIEW_PX]
    assert (top == 255).all(axis=-1).mean() > 0.1
    assert (top == (230, 40, 40)).all(axis=-1).sum() > 50


@pytest.mark.parametrize("count", [1, 2, 7, 28])
def test_a_sheet_of_any_number_of_rows_holds_each_once_and_is_about_square(count: int):
    rows = [np.full((36, 186, 3), index + 1, np.uint8) for index in range(count)]
    sheet = lay_out(rows)
    for index in range(count):
        assert (sheet == index + 1).sum() == rows[0].size
    assert set(np.unique(sheet)) - set(range(1, count + 1)) <= {255}
    assert max(sheet.shape[:2]) <= 3 * min(sheet.shape[:2]) or count <= 2


def test_a_sheet_has_a_row_for_each_room_and_is_written_whole(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(gallery, "draw_room", lambda room: drawn.append(room) or np.full((40, 90, 3), 99, np.uint8))
    path = tmp_path / "out" / "rooms.png"
    draw_gallery(["kitchen", "labyrinth"], [2, 6], path)
    rooms = [("kitchen", "u", 2), ("kitchen", "l", 6), ("labyrinth", "rectangle", 2), ("labyrinth", "rectangle", 6)]
    assert [(room.kind, room.shape, room.seed) for room in drawn] == rooms
    image = cv2.imread(str(path))
    assert image is not None and (image == 99).all() and image.size == 4 * 40 * 90 * 3
    assert [file.name for file in path.parent.iterdir()] == ["rooms.png"]
