"""A side that is hidden is put where the side across and the cell's size say; how well the other cells know that size.

Cells of one eye are measured a little larger or smaller than expected, all by the same share: the blur, the wing's
pose and what is told of the cells' size are not exactly right. The share, and its scatter beyond the measurement's own
noise, come from the cells of the last tick all of whose sides were seen. A side that is in the image and still not seen
is covered by something that may disturb the side across as well: there the size is believed less. A cell of which both
eyes miss a side along the same axis is measured by nobody.
"""

from fsw.vision.corners import Cells
from fsw.vision.edges import FloatArray
from fsw.vision.rig import Eyes, image_point
from wingbeat.kernels import tick_kernel

SHAPE_SIGMA = 1e-3  # a cell's expected size is right to this share, as told, and beside what covers a side
# Hidden sides lie at the view's rim, where the surface's slope is least sure:
LEAST_SIGMA = 1e-4  # the size is known no better than this, however little the cells scatter,
RIM = 2.0  # and is off by so many times as much as theirs
LEAST_CELLS = 12
SLOPE = 2e-3  # that the surface may have wrong at the rim beside a fold: a cell seen askew changes its extent with it


@tick_kernel
def forget_size(size: FloatArray) -> None:
    """Set size (2, 2), share of the expected extent and its variance, along Y and along X, to what is told."""
    for row in range(2):
        size[row, 0], size[row, 1] = 1.0, SHAPE_SIGMA * SHAPE_SIGMA


@tick_kernel
def add_size(
    size: FloatArray, row: int, expected_px: float, measured_px: float, noise_px2: float, sums: FloatArray
) -> None:
    """Add one whole cell's extent, and the variance that its two sides have, to sums (2, SIZE_SUMS)."""
    beyond = measured_px / expected_px - size[row, 0]
    sums[row, 0] += 1.0
    sums[row, 1] += beyond
    sums[row, 2] += beyond * beyond
    sums[row, 3] += noise_px2 / (expected_px * expected_px)


@tick_kernel
def learn_size(size: FloatArray, sums: FloatArray) -> None:
    """Take over the cells' mean size, and how far they were off what was known before: the next tick will be, too."""
    for row in range(2):
        count = sums[row, 0]
        if count < LEAST_CELLS:
            size[row, 1] = SHAPE_SIGMA * SHAPE_SIGMA
            continue
        size[row, 0] += sums[row, 1] / count
        size[row, 1] = max(RIM * RIM * (sums[row, 2] - sums[row, 3]) / count, LEAST_SIGMA * LEAST_SIGMA)


@tick_kernel
def is_inside(eyes: Eyes, eye: int, c: FloatArray, k: int) -> bool:
    """Whether both ends of side k of a cell of corners c (4, 2), ideal pixels, lie in this eye's image."""
    k1 = (k + 1) % 4
    start, _, _ = image_point(eyes, eye, c[k, 0], c[k, 1])
    end, _, _ = image_point(eyes, eye, c[k1, 0], c[k1, 1])
    return start and end


@tick_kernel
def stand_in(
    size: FloatArray,
    row: int,
    covered: bool,
    expected_px: float,
    extent_px: float,
    across_px: float,
    variance_px2: float,
    tilt: float,
) -> tuple[float, float]:
    """Where a hidden side stands outwards of where it was looked for, and its variance.

    covered: whether all of it should be in the image.
    tilt: tangent of the angle by which the cell is seen askew along this extent.
    expected_px: the cell's extent by the surface; extent_px: by where its sides were looked for; across_px,
    variance_px2: of the side across, outwards. The centre moves by all of that side's error e: by half of e with the
    side itself, by half with what stands in. The variance is such that both, added as if independent, give that.
    """
    share2 = max(size[row, 1], SHAPE_SIGMA * SHAPE_SIGMA) if covered else size[row, 1]
    sigma2 = (share2 + SLOPE * SLOPE * tilt * tilt) * expected_px * expected_px
    return size[row, 0] * expected_px - extent_px - across_px, 3.0 * variance_px2 + sigma2


@tick_kernel
def drop_unseen(left: Cells, right: Cells) -> None:
    """Find no cell that neither eye sees from side to side, along X or along Y: its place would hang on the size alone.

    Where one eye sees both sides, that eye's place outweighs the other's. A surface that a fast motion took by
    surprise, or that few cells hold beyond a bar, shows extents at the rim wrong by a tenth of a pixel, a hundred times
    what a side seen is off by.
    """
    for n in range(len(left.found)):
        for k in range(2):
            if not (left.paired[n, k] or right.paired[n, k]):
                for eye in (left, right):
                    eye.found[n] = eye.paired[n, 0] = eye.paired[n, 1] = False
