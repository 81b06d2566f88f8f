"""The next cell's pixels are asked for: all of its box, and nothing that is not in the image."""

import numpy as np
import pytest

from fsw.vision.ahead import AT, FIRST, LAST, LAST_ROW, LINE, LINES_A_STRIP, MARGIN_PX, ROW, ask, look_ahead, make_ahead

FLAT = np.array([800.0, 800.0, 200.0, 150.0]), np.zeros(5)
CELL = np.array([[0.0, 0.0], [120.0, 20.0], [110.0, 90.0], [-10.0, 70.0]])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("place", [(150.0, 100.0), (-60.0, -30.0), (350.0, 260.0)])
def test_the_whole_box_is_asked_for_and_nothing_outside_of_the_image(dtype: type, place: tuple[float, float]) -> None:
    image, ahead = np.zeros((300, 400), dtype), make_ahead()
    corners = CELL + place
    look_ahead(image, corners, *FLAT, ahead)
    size = image.itemsize
    left, top = np.maximum(corners.min(axis=0) - MARGIN_PX, 0.0)
    right, bottom = np.minimum(corners.max(axis=0) + MARGIN_PX, (399.0, 299.0))
    assert (ahead[FIRST], ahead[LAST]) == (int(left) * size, int(right) * size) and ahead[LAST] < image.strides[0]
    assert (ahead[ROW], ahead[LAST_ROW]) == (int(top), int(bottom)) and ahead[AT] == ahead[FIRST]
    rows, lines = int(bottom) - int(top) + 1, (ahead[LAST] - ahead[FIRST]) // LINE + 1
    for _ in range(rows * lines // LINES_A_STRIP):
        assert top <= ahead[ROW] <= bottom and ahead[FIRST] <= ahead[AT] <= ahead[LAST]
        ask(image, ahead)
    ask(image, ahead)
    assert ahead[ROW] > ahead[LAST_ROW]
    done = ahead.copy()
    ask(image, ahead)
    assert np.array_equal(ahead, done)


def test_at_first_nothing_is_asked_for() -> None:
    ahead = make_ahead()
    before = ahead.copy()
    ask(np.zeros((8, 8), np.uint8), ahead)
    assert np.array_equal(ahead, before)


def test_a_cell_out_of_view_has_no_box() -> None:
    ahead = make_ahead()
    look_ahead(np.zeros((300, 400), np.uint8), CELL + np.array([0.0, 900.0]), *FLAT, ahead)
    assert ahead[ROW] > ahead[LAST_ROW]
