"""What all edges of an eye along X, or along Y, have in common, the blur and the width of the lines: found every tick.

All good edges' normal equations for them are added up, each edge's own grey values and offset eliminated, so blur and
width are found together. What they are still wrong by pulls sides: the two sides of a cell across each other alike, so
that its centre stays, unless one of them is a border. As long as they settle, the centres' covariance says so.
"""

from fsw.vision.corners import Cells
from fsw.vision.edges import BLUR, COMMON, CROSS, EACH, OWN, RIGHT, WIDTH, FloatArray
from wingbeat.kernels import tick_kernel

BLUR_RANGE_PX = (0.15, 4.0)
WIDTH_RANGE = (0.7, 1.4)
LEAST_NOISE = 1.0 / 12.0  # grey values squared
JUMPED = 2.0  # times as much noise as was known, or as little: edges were weighed by another
HOTTER = 3.0  # times the noise expected of a side's pixels: more is a hot one's
AGAIN = 0.01  # a correction larger than this, in px of blur or relative width, is taken over and all measured again
LINEAR = 0.05  # of a blur that is wrong: what it pulls centres by beyond what the models, linear in it, know


@tick_kernel
def correct(pooled: FloatArray, step: FloatArray) -> None:
    """Write the step (COMMON,) by which blurs (px) and widths (relative) are wrong, as pooled (COMMON, 3) has them.

    The width is eliminated, then the blur found, then the width. What no edge tells of stays.
    """
    step[:] = 0.0
    for i in (BLUR, EACH + BLUR):
        j = i + WIDTH
        right, own = pooled[i, RIGHT], pooled[i, OWN]
        if pooled[j, OWN] > 0.0:
            right -= pooled[j, CROSS] / pooled[j, OWN] * pooled[j, RIGHT]
            own -= pooled[j, CROSS] / pooled[j, OWN] * pooled[j, CROSS]
        if own > 0.0:
            step[i] = right / own
        if pooled[j, OWN] > 0.0:
            step[j] = (pooled[j, RIGHT] - pooled[j, CROSS] * step[i]) / pooled[j, OWN]


@tick_kernel
def tell_noise(pooled: FloatArray, noise: FloatArray, grey: float, variance: float, count: float) -> None:
    """Add to the pooled noise what so many pixels of a grey value tell: their variance, less what a hot one adds.

    noise (2,): known before.
    """
    expected = noise[0] + noise[1] * max(grey, 0.0)
    weight = count / (expected * expected)
    if noise[0] > LEAST_NOISE or noise[1] > 0.0:  # it has been learnt
        variance = min(variance, HOTTER * expected)
    value = weight
    for i in range(3):
        pooled[COMMON, i] += value
        pooled[COMMON + 1, i] += value * variance
        value *= grey


@tick_kernel
def learn_noise(pooled: FloatArray, noise: FloatArray) -> bool:
    """Write noise (2,), variance of a pixel and its growth with the grey value, as the edges' residuals have it.

    Shot noise makes it grow; rounding leaves no less than LEAST_NOISE. Without edges it stays. Returns whether it has
    jumped, as at the edges' mean grey value.
    """
    n0, n1, n2 = pooled[COMMON]
    t0, t1, _ = pooled[COMMON + 1]
    det = n0 * n2 - n1 * n1
    if det <= 1e-9 * n0 * n2:
        return False
    before = noise[0] + noise[1] * n1 / n0
    growth = (n0 * t1 - n1 * t0) / det
    at_zero = (t0 - n1 * growth) / n0
    if at_zero < LEAST_NOISE:
        at_zero, growth = LEAST_NOISE, (t1 - LEAST_NOISE * n1) / n2
    if growth < 0.0:
        at_zero, growth = max(t0 / n0, LEAST_NOISE), 0.0
    noise[0], noise[1] = at_zero, growth
    after = at_zero + growth * n1 / n0
    return after > JUMPED * before or before > JUMPED * after


@tick_kernel
def adapt(step: FloatArray, share: float, blur_px: FloatArray, width_scale: FloatArray) -> None:
    """Take over a share of the step (COMMON,) in the blur_px (2,) and width_scale (2,) of one eye."""
    for row in range(2):
        blur, width = share * step[EACH * row + BLUR], share * step[EACH * row + WIDTH]
        blur_px[row] = min(max(blur_px[row] + blur, BLUR_RANGE_PX[0]), BLUR_RANGE_PX[1])
        width_scale[row] = min(max(width_scale[row] + width, WIDTH_RANGE[0]), WIDTH_RANGE[1])


@tick_kernel
def is_far(step: FloatArray) -> bool:
    """Whether a step (COMMON,) is too large for what edges were measured with before it."""
    largest = 0.0
    for i in range(COMMON):
        largest = max(largest, abs(step[i]))
    return largest > AGAIN


@tick_kernel
def widen_unsettled(step: FloatArray, out: Cells) -> None:
    """Widen the covariance of found cells by what a step (COMMON,) still to be taken would move their centres by."""
    wrong = LINEAR * max(abs(step[BLUR]), abs(step[EACH + BLUR]))
    for n in range(len(out.found)):
        if not out.found[n]:
            continue
        x, y = 0.0, 0.0
        for i in range(COMMON):
            x, y = x + out.pull[n, i, 0] * step[i], y + out.pull[n, i, 1] * step[i]
        C = out.covariance_px2[n]
        C[0], C[1], C[2] = C[0] + x * x + wrong * wrong, C[1] + x * y, C[2] + y * y + wrong * wrong
