"""The centres as the paper prints them (Eq. 6-12), in the place of the fitted ones: the method `paper`."""

import numpy as np

from fsw.vision.cells import paper_centres
from fsw.vision.edges import FloatArray, Image
from fsw.vision.tracking import Tracker

VARIANCE_PX2 = 0.35**2  # of the mean of boundary pixels, as measured against truth
AREA_MARGIN = 0.4  # a blob may be so much smaller or larger than a cell in view
REACH = 0.4  # of a cell's smaller side: a centre farther from where it is expected is another cell's


def use_printed_centres(tracker: Tracker, left: Image, right: Image) -> None:
    """Take the means of boundary pixels for the centres of the cells in view; cells without one are lost."""
    for eye, image in enumerate((left, right)):
        _replace(tracker, eye, paper_centres(image, tracker.grid.dark, _area_px(tracker, eye)))


def _area_px(tracker: Tracker, eye: int) -> tuple[float, float]:
    """Least and greatest area of a cell in view of this eye, with a margin, in square pixels."""
    c = tracker.expected_px[eye][tracker.wanted]
    if len(c) == 0:
        return 0.0, 0.0
    d, e = c[:, 2] - c[:, 0], c[:, 3] - c[:, 1]
    area = 0.5 * np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0])
    return (1.0 - AREA_MARGIN) * float(area.min()), (1.0 + AREA_MARGIN) * float(area.max())


def _replace(tracker: Tracker, eye: int, image_px: FloatArray) -> None:
    """Give centres (K, 2), in image pixels, to the cells that they are nearest to."""
    cells = tracker.cells[eye]
    cells.found[:] = cells.whole[:] = False
    cells.paired[:] = False  # a blob has no sides whose distance would tell its size
    if len(image_px) == 0:
        return
    ideal = tracker.rig.undistort(eye, image_px)
    expected = tracker.expected_px[eye]
    side = np.linalg.norm(expected[:, [1, 3]] - expected[:, [0]], axis=2).min(axis=1)
    for n in np.flatnonzero(tracker.wanted):
        distance = np.linalg.norm(ideal - tracker.expected_centre_px[eye, n], axis=1)
        nearest = int(np.argmin(distance))
        if distance[nearest] < REACH * side[n]:
            cells.centre_px[n] = cells.corners_px[n] = ideal[nearest]
            cells.covariance_px2[n] = VARIANCE_PX2, 0.0, VARIANCE_PX2
            cells.found[n] = True
