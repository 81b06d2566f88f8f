"""The next cell's pixels are asked for: all that its sides need, little else, and nothing that is not in the image."""

from typing import Any

import numpy as np
import pytest

from fsw.vision import ahead as module
from fsw.vision.ahead import LAST_ROW, LINE, MARGIN_PX, ROW, ROWS_AT_ONCE, ask, look_ahead, make_ahead

FLAT = np.array([800.0, 800.0, 500.0, 150.0]), np.zeros(5)
CELL = np.array([[0.0, 0.0], [290.0, 20.0], [280.0, 130.0], [-10.0, 110.0]])
TURNED = np.array([[100.0, 0.0], [200.0, 100.0], [100.0, 200.0], [0.0, 100.0]])


def asked(monkeypatch: pytest.MonkeyPatch, image: Any, corners: Any) -> set[tuple[int, int]]:
    """Rows and bytes of the lines that are asked for."""
    ahead, lines = make_ahead(), set()
    monkeypatch.setattr(module, "prefetch", lambda _, row, at: lines.add((row, at)))
    look_ahead(image, corners, *FLAT, ahead)
    for _ in range((ahead[LAST_ROW] - ahead[ROW]) // ROWS_AT_ONCE + 1):
        ask.py_func(image, ahead)
    assert ahead[ROW] > ahead[LAST_ROW]
    done = len(lines)
    ask.py_func(image, ahead)
    assert len(lines) == done
    return lines


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("place", [(250.0, 100.0), (-60.0, -30.0), (950.0, 260.0)])
@pytest.mark.parametrize("cell", [CELL, TURNED])
def test_all_that_the_sides_need_is_asked_for_and_nothing_outside_of_the_image(
    dtype: type, place: tuple[float, float], cell: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, corners = np.zeros((300, 1000), dtype), cell + place
    lines = asked(monkeypatch, image, corners)
    assert all(0 <= row < 300 and 0 <= at < image.strides[0] for row, at in lines)
    share = np.linspace(0.0, 1.0, 400)[:, None]
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        across = np.array([0.0, 1.0] if abs(b[0] - a[0]) > abs(b[1] - a[1]) else [1.0, 0.0])
        for off in (-MARGIN_PX + 1.0, 0.0, MARGIN_PX - 1.0):
            x, y = (a + share * (b - a) + off * across).astype(int).T
            inside = (x >= 0) & (x < 1000) & (y >= 0) & (y < 300)
            bytes_ = x[inside] * image.itemsize
            assert set(zip(y[inside].tolist(), (bytes_ - bytes_ % LINE).tolist(), strict=True)) <= lines


def test_what_lies_inside_of_all_sides_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    image, corners = np.zeros((300, 1000), np.uint8), CELL + np.array([250.0, 100.0])
    box = np.ptp(corners, axis=0) + 2.0 * MARGIN_PX
    assert len(asked(monkeypatch, image, corners)) < 0.8 * box[1] * (box[0] / LINE + 1.0)


def test_nothing_is_asked_for_before_a_cell_is_known() -> None:
    ahead = make_ahead()
    ask(np.zeros((50, 60), np.uint8), ahead)
    assert (ahead == make_ahead()).all()


def test_a_cell_out_of_view_has_no_rows() -> None:
    ahead = make_ahead()
    look_ahead(np.zeros((300, 400), np.uint8), CELL + np.array([0.0, 900.0]), *FLAT, ahead)
    assert ahead[ROW] > ahead[LAST_ROW]
