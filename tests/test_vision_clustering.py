"""K-means is exact, and local thresholds survive light that a global one does not."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.vision.clustering import binarise, histogram, kmeans
from fsw.vision.ridges import local_cells


def _cost(values: np.ndarray, count: np.ndarray, cuts: tuple[int, ...]) -> float:
    parts = np.split(np.arange(len(values)), cuts)
    means = [np.average(values[p], weights=count[p]) for p in parts]
    return float(sum(np.sum(count[p] * (values[p] - m) ** 2) for p, m in zip(parts, means, strict=True)))


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.integers(0, 255), st.integers(1, 500), min_size=3, max_size=12), st.integers(2, 3))
def test_kmeans_finds_the_least_sum_of_squares_of_all_partitions(grey: dict[int, int], classes: int) -> None:
    count = np.zeros(256, dtype=np.int64)
    count[list(grey)] = list(grey.values())
    values = np.flatnonzero(count)
    centres, thresholds = kmeans(count, classes)
    cuts = tuple(int(np.searchsorted(values, t, side="right")) for t in thresholds)
    best = min(_cost(values, count[values], c) for c in combinations(range(1, len(values)), classes - 1))
    assert _cost(values, count[values], cuts) == pytest.approx(best, rel=1e-9, abs=1e-6)
    assert np.all(np.diff(centres) > 0)


def test_kmeans_takes_sixteen_bits_and_fewer_values_than_classes() -> None:
    image = np.array([[10, 10, 40000, 65535, 40010]], dtype=np.uint16)
    centres, thresholds = kmeans(histogram(image, 65536, 1))
    assert centres == pytest.approx([10.0, 40005.0, 65535.0])
    assert list(thresholds) == [10, 40010]
    assert len(kmeans(histogram(np.full((2, 2), 7, np.uint8), 256, 1))[0]) == 1
    assert not binarise(np.full((2, 2), 7, np.uint8), dark=True).any()


def _grid(light: np.ndarray) -> np.ndarray:
    view = np.full(light.shape, 30.0)
    view[:, ::40], view[:, 1::40] = 150.0, 150.0
    view[::24, :], view[1::24, :] = 150.0, 150.0
    return (view * light).astype(np.float32)


def test_local_threshold_keeps_lines_and_cells_where_a_global_one_loses_half() -> None:
    y, x = np.mgrid[:360, :600]
    for light in (1.0 - 0.9 * x / 600, np.where(y > 170, 0.3, 1.0)):
        view = _grid(light)
        line = (x % 40 < 2) | (y % 24 < 2)
        cells = local_cells(view, (38.0, 22.0), (2.0, 2.0))
        crude = binarise(view.astype(np.uint8), dark=True, row_step=1)
        inner = (y > 24) & (y < 336) & (x > 40) & (x < 560)
        assert np.mean((cells > 0)[inner] == ~line[inner]) > 0.985
        assert np.mean((crude > 0)[inner & line]) > 0.1
