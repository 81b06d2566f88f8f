"""One eye's part of a tick in TRACK, whole: from its image to its cells, and what all their edges have in common.

One kernel, for each call from the interpreter finds it, and what hands the arrays over, driven out of the caches by the
pixels of the call before.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fsw.vision.blur import STEP_ROWS
from fsw.vision.corners import Cells
from fsw.vision.edges import FloatArray, Image, Scratch, make_scratch
from fsw.vision.hot import shown_full_scale
from fsw.vision.quads import measure_cells
from fsw.vision.rig import Eyes
from fsw.vision.settling import adapt, correct, is_far, learn_noise, widen_unsettled
from fsw.vision.sides import lens_of
from fsw.vision.standing_in import learn_size
from wingbeat.kernels import tick_kernel

MOST_LOOKS = 8  # at a few cells, at most, until blur and widths are settled


class View(NamedTuple):
    """What one eye expects and measures of N cells: views of the tracker's arrays, and memory of its own."""

    expected_px: FloatArray  # (N, 4, 2) and the next six, up to the sizes: see measure_cells
    deviation_px: FloatArray  # (N, 4, 2)
    depth_mm: FloatArray  # (N, 4)
    line_ratio: FloatArray  # (N, 4)
    neighbour: NDArray[np.int64]  # (N, 4)
    width_scale: FloatArray  # (2,)
    size: FloatArray  # (2, 2)
    blur_px: FloatArray  # (2,) of the lens, across sides along X, along Y
    noise: FloatArray  # (2,) variance of a pixel, and its growth with the grey value
    correction: FloatArray  # (COMMON,) of blur and widths, as this tick's edges have it
    cells: Cells
    steps: FloatArray  # (2, STEP_ROWS, 3) see tabulate_step
    scratch: Scratch


def make_view(
    expected: tuple[FloatArray, FloatArray, FloatArray],
    lines: tuple[FloatArray, NDArray[np.int64]],
    learnt: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    cells: Cells,
) -> View:
    """Take the memory. expected: expected_px to depth_mm; lines: their ratio, neighbour; learnt: from width_scale."""
    return View(*expected, *lines, *learnt, cells, np.zeros((2, STEP_ROWS, 3)), make_scratch())


@tick_kernel
def measure_view(
    image: Image,
    eyes: Eyes,
    eye: int,
    view: View,
    wanted: NDArray[np.bool_],
    order: NDArray[np.int64],
    few: NDArray[np.int64],
    dark: bool,
    stride: int,
    adaptation: float,
) -> None:
    """Measure all wanted cells (N,) of one image, in their order (N,), and learn blur, widths and noise from them.

    few: some of the cells. adaptation: share of the correction of blur and widths that is taken over. dark, stride: see
    measure_cells. Where blur or noise have jumped, a few cells settle them, and then all are measured once more: what
    edges would say with another blur they tell only for a small step.
    """
    view.scratch.full[0] = shown_full_scale(image)
    chosen, looks, whole, done = order, 0, True, False
    while not done:
        along_x = lens_of(eyes, eye, view.blur_px[0], view.steps[0], view.noise)
        along_y = lens_of(eyes, eye, view.blur_px[1], view.steps[1], view.noise)
        measure_cells(
            image,
            eyes,
            eye,
            (along_x, along_y),
            view.expected_px,
            view.deviation_px,
            view.depth_mm,
            wanted,
            chosen,
            view.line_ratio,
            view.neighbour,
            view.width_scale,
            view.size,
            dark,
            stride,
            view.scratch,
            view.cells,
        )
        learn_size(view.size, view.scratch.sizes)
        correct(view.scratch.pooled, view.correction)
        jumped = learn_noise(view.scratch.pooled, view.noise)
        far = jumped or is_far(view.correction)
        done = whole and (looks > 0 or not far)
        if not done:
            adapt(view.correction, 1.0, view.blur_px, view.width_scale)
            whole = looks == MOST_LOOKS or not far
            chosen = order if whole else few
            looks += 1
    widen_unsettled(view.correction, view.cells)
    adapt(view.correction, adaptation, view.blur_px, view.width_scale)
