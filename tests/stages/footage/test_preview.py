"""The sheet on which people look at their crops."""

import numpy as np

from artifacts import caption
from stages.config.demonstrations import Crop
from stages.footage.preview import preview_cell, preview_sheet

RED, WHITE, GREY = (220, 0, 0), (255, 255, 255), (128, 128, 128)


def drawn(crop, size=(360, 480), name="x.mp4"):
    """The picture below the caption, of a black one of this size."""
    cell = preview_cell(np.zeros((*size, 3), np.uint8), crop, name)
    above = caption([name], [240])
    np.testing.assert_array_equal(cell[: len(above)], above)
    assert cell.dtype == np.uint8 and cell.shape == (len(above) + 180, 240, 3)
    return cell[len(above) :]


def test_the_crop_is_a_red_rectangle_with_a_white_rim():
    picture = drawn(Crop(80, 60, 200, 120))  # half as large on the sheet: 40, 30 to 139, 89
    for y, x in ((30, 60), (89, 60), (50, 40), (50, 139)):
        assert tuple(picture[y, x]) == RED
    for y, x in ((28, 60), (91, 60), (50, 38), (50, 141), (32, 60)):
        assert tuple(picture[y, x]) == WHITE
    for y, x in ((60, 80), (10, 10), (34, 60), (26, 60)):
        assert not picture[y, x].any()


def test_pictures_of_other_shapes_stand_in_the_middle_on_grey():
    high = drawn(Crop(0, 0, 10, 10), size=(180, 90))
    assert (high[:, :75] == 128).all() and (high[:, 165:] == 128).all() and not (high[20:, 80:160] == 128).any()
    wide = drawn(Crop(0, 0, 10, 10), size=(40, 240))
    assert (wide[:70] == 128).all() and (wide[110:] == 128).all() and not (wide[71:109] == 128).any()
    small = drawn(Crop(0, 0, 2, 2), size=(18, 24))
    assert not (small == 128).all(axis=2).any(), "enlarged to the cell"
    line = drawn(Crop(0, 0, 2, 1), size=(1, 2000))
    assert not (line[89:90, 3:-3] == 128).all(axis=2).any()


def test_a_crop_beyond_the_picture_is_drawn_as_far_as_it_goes():
    picture = drawn(Crop(80, 60, 10**9, 10**9))
    assert tuple(picture[100, 40]) == RED and tuple(picture[30, 200]) == RED
    assert not picture[100, 100].any()


def test_long_names_keep_their_end():
    name = "a-name-of-a-video-that-is-far-too-long-to-be-shown.mp4"
    shown = "..." + name[-31:]
    assert len(shown) == 34
    cell = preview_cell(np.zeros((36, 48, 3), np.uint8), Crop(0, 0, 9, 9), name)
    above = caption([shown], [240])
    np.testing.assert_array_equal(cell[: len(above)], above)
    just = name[-34:]
    cell = preview_cell(np.zeros((36, 48, 3), np.uint8), Crop(0, 0, 9, 9), just)
    np.testing.assert_array_equal(cell[: len(above)], caption([just], [240]))


def test_cells_stand_in_rows_about_as_many_as_columns():
    cells = [np.full((30, 40, 3), 10 * k, np.uint8) for k in range(1, 6)]
    sheet = preview_sheet(cells)
    places = {k: np.argwhere((sheet == 10 * k).all(axis=2)) for k in range(1, 6)}
    corners = {k: tuple(found.min(axis=0)) for k, found in places.items()}
    assert all(tuple(found.max(axis=0) - found.min(axis=0) + 1) == (30, 40) for found in places.values())
    assert [corners[k][1] - corners[1][1] for k in range(1, 6)] == [0, 46, 92, 0, 46]
    assert [corners[k][0] - corners[1][0] for k in range(1, 6)] == [0, 0, 0, 36, 36]
