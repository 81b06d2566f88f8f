"""All cells of a wing have their expected size, up to what all have in common: a cell that has not is not trusted."""

import math

from fsw.vision.edges import FloatArray
from fsw.vision.perspective import extent_across, side_normal
from fsw.vision.quads import Cells
from wingbeat.kernels import kernel

GATE_SIGMAS = 5.0  # a size farther from the others' than noise and their scatter explain: the centre is off by as many
ODD_PX = 0.5  # a size as odd as this is a wrong edge, whose error no sigma describes: the cell is not found
_ROUNDS = 5  # mean and scatter of the sizes, each time without those that are odd


@kernel
def widen_odd_sizes(expected_px: FloatArray, deviation_px: FloatArray, work: FloatArray, out: Cells) -> None:
    """Widen the covariance of whole cells one of whose extents is odd: one of the two sides is off by the difference.

    expected_px, deviation_px (N, 4, 2): see measure_cells; the deviation is left out, or a wrong side would confirm
    itself from tick to tick. work (N, 3): written. Which side is wrong is not known, so both may be: the centre is off
    by half of the difference for each.
    """
    for axis in range(2):
        total, count = 0.0, 0
        for n in range(len(expected_px)):
            work[n, 0] = math.nan
            if not out.whole[n]:
                continue
            _, nx, ny = side_normal(expected_px[n], axis)
            work[n, 0] = extent_across(out.corners_px[n], axis, nx, ny)
            e, d = expected_px[n], deviation_px[n]
            work[n, 0] -= extent_across(e, axis, nx, ny) - extent_across(d, axis, nx, ny)
            work[n, 1], work[n, 2] = nx, ny
            total += work[n, 0]
            count += 1
        if count < 3:
            continue
        mean, limit = total / count, math.inf
        scatter = 0.0
        for _ in range(_ROUNDS):
            total, squares, count = 0.0, 0.0, 0
            for n in range(len(expected_px)):
                off = work[n, 0] - mean
                if abs(off) <= limit:
                    total, squares, count = total + off, squares + off * off, count + 1
            if count < 3:
                break
            scatter = math.sqrt(squares / count)
            mean += total / count
            limit = GATE_SIGMAS * scatter
        for n in range(len(expected_px)):
            off, nx, ny = work[n, 0] - mean, work[n, 1], work[n, 2]
            if math.isnan(off):
                continue
            C = out.covariance_px2[n]
            # The extent is the difference of two sides, the centre their mean: four times the variance.
            own = 4.0 * (C[0] * nx * nx + 2.0 * C[1] * nx * ny + C[2] * ny * ny)
            if off * off > GATE_SIGMAS**2 * max(own, scatter * scatter):
                if abs(off) > ODD_PX:
                    out.found[n] = out.whole[n] = False
                wider = 0.5 * off * off
                C[0], C[1], C[2] = C[0] + wider * nx * nx, C[1] + wider * nx * ny, C[2] + wider * ny * ny
