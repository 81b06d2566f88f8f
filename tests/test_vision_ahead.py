"""The next side's pixels are asked for: all that it needs, little else, and nothing that is not in the image."""

from typing import Any

import numpy as np
import pytest

from fsw.vision import ahead as module
from fsw.vision.ahead import MARGIN_PX, PARTS, ask, look_ahead, make_ahead, next_wanted
from hal.frame import LINE, make_frames

HEIGHT, WIDTH = 300, 1000
SIDES = [(0.0, 0.0, 290.0, 20.0), (280.0, 130.0, 0.0, 0.0), (30.0, 0.0, 20.0, 110.0), (0.0, 99.0, 70.0, 0.0)]


def asked(monkeypatch: pytest.MonkeyPatch, image: Any, start: Any, end: Any) -> set[tuple[int, int]]:
    """Rows and bytes of the lines that are asked for."""
    ahead, lines = make_ahead(), set()
    monkeypatch.setattr(module, "prefetch", lambda _, row, at: lines.add((row, at // LINE * LINE)))
    look_ahead(image, np.array(start), np.array(end), ahead)
    for _ in range(PARTS):
        ask.py_func(image, ahead)
    done = len(lines)
    ask.py_func(image, ahead)
    assert len(lines) == done
    return lines


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("place", [(250.0, 100.0), (-60.0, -30.0), (950.0, 260.0)])
@pytest.mark.parametrize("side", SIDES)
def test_all_that_a_side_needs_is_asked_for_and_nothing_outside_of_the_image(
    dtype: type, place: tuple[float, float], side: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, (start, end) = make_frames((HEIGHT, WIDTH), dtype), np.reshape(side, (2, 2)) + place
    lines = asked(monkeypatch, image, start, end)
    assert all(0 <= row < HEIGHT and 0 <= at < WIDTH * image.itemsize for row, at in lines)
    across = np.array([0.0, 1.0] if abs(end[0] - start[0]) >= abs(end[1] - start[1]) else [1.0, 0.0])
    needed = set()
    for off in np.linspace(-MARGIN_PX, MARGIN_PX, 5):
        x, y = np.floor(start + np.linspace(0.0, 1.0, 400)[:, None] * (end - start) + off * across).astype(int).T
        inside = (x >= 0) & (x < WIDTH) & (y >= 0) & (y < HEIGHT)
        bytes_ = x[inside] * image.itemsize
        needed |= set(zip(y[inside].tolist(), (bytes_ - bytes_ % LINE).tolist(), strict=True))
    missed = needed - lines
    assert len(missed) <= 2  # at its ends, which no strip reads
    assert place != (250.0, 100.0) or len(lines) < 1.5 * len(needed)


def test_a_side_out_of_view_is_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    image = make_frames((HEIGHT, WIDTH), np.uint8)
    for x, y in ((0.0, 900.0), (0.0, -900.0)):
        assert not asked(monkeypatch, image, (300.0 + x, 100.0 + y), (310.0 + x, 200.0 + y))
        assert not asked(monkeypatch, image, (300.0 + x, 100.0 + y), (500.0 + x, 110.0 + y))


@pytest.mark.parametrize("end", [(300.0, 100.0), (np.nan, 100.0), (np.nan, np.nan)])
def test_a_side_of_no_length_asks_for_nothing(end: tuple[float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    assert not asked(monkeypatch, make_frames((HEIGHT, WIDTH), np.uint8), (300.0, 100.0), end)


def test_nothing_is_asked_for_before_a_side_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    ahead, lines = make_ahead(), []
    monkeypatch.setattr(module, "prefetch", lambda *line: lines.append(line))
    ask.py_func(make_frames((50, 60), np.uint8), ahead)
    assert not lines


def test_the_next_cell_is_the_next_one_wanted() -> None:
    order, wanted = np.array([3, 1, 0, 2]), np.array([True, False, True, True])
    assert [next_wanted(order, wanted, place) for place in range(4)] == [0, 0, 2, 2]
