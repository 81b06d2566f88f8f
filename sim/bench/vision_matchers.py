"""Peers of the table `methods`: from a pair of images to matched points, each with what its field keeps.

A matcher returns left and right image px (n, 2) each; nobody tells it the truth.
"""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsw.vision.cells import paper_centres
from fsw.vision.descriptor import describe, find_borders, match
from fsw.vision.enhancement import enhance_points, plane_homography
from fsw.vision.printed import AREA_MARGIN
from sim.bench.vision_stand import Stand

FloatArray = NDArray[np.float64]
Image = NDArray[Any]
Matches = tuple[FloatArray, FloatArray]
Matcher = Callable[[Image, Image], Matches]

RATIO = 0.8  # of the nearest to the second nearest descriptor (Lowe, 2004)
MOST_POINTS = 4096
SAME = 0.25  # of the smaller pitch: descriptors nearer than this are one cell's
NOTHING: Matches = (np.empty((0, 2)), np.empty((0, 2)))


def ours(stand: Stand) -> Matcher:
    """Search, then one tick of the flight's tasks; the points that it marks valid."""

    def find(left: Image, right: Image) -> Matches:
        if not stand.acquire(left, right).ok:
            return NOTHING
        stand.tick(left, right)
        tracker, valid = stand.tracker, stand.tracker.points.valid
        found = [stand.rig.distort(eye, tracker.centre_px[eye][valid]) for eye in (0, 1)]
        return found[0], found[1]

    return find


def paper_literal(stand: Stand) -> Matcher:
    """Eq. 6-12 for the centres, Eq. 13 with the nominal pose, Eq. 21-23 as printed, nearest both ways."""
    grid, prior, rig = stand.grid, stand.prior, stand.rig
    pitch = grid.panels[0].pitch_mm

    def find(left: Image, right: Image) -> Matches:
        centres, described = [], []
        for eye, image in enumerate((left, right)):
            H = plane_homography(rig, eye, prior.rotation, prior.translation_mm)
            px = paper_centres(image, grid.dark, _area_px(stand, eye))
            xy = enhance_points(H, rig.undistort(eye, px)) if len(px) else px
            borders = find_borders(xy, pitch) if len(px) else None
            if borders is None:
                return NOTHING
            centres.append(px)
            described.append(describe(xy, borders))
        pairs = match(described[0], described[1], SAME * min(pitch))
        return centres[0][pairs[:, 0]], centres[1][pairs[:, 1]]

    return find


def _area_px(stand: Stand, eye: int) -> tuple[float, float]:
    """Least and greatest area of a cell at the nominal pose, with the margin of the flight's method `paper`."""
    grid, prior = stand.grid, stand.prior
    xyz = np.concatenate([grid.corners_mm, np.zeros((grid.count, 4, 1))], axis=2)
    px = stand.rig.project_ideal(eye, xyz @ prior.rotation.T + prior.translation_mm)
    inside = ((px > 0.0) & (px < stand.rig.size[eye])).all(axis=(1, 2))
    d, e = px[inside, 2] - px[inside, 0], px[inside, 3] - px[inside, 1]
    area = 0.5 * np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0])
    return (1.0 - AREA_MARGIN) * float(area.min()), (1.0 + AREA_MARGIN) * float(area.max())


def sift(left: Image, right: Image) -> Matches:
    """SIFT with the ratio test."""
    return _by_ratio(cv2.SIFT_create(nfeatures=MOST_POINTS), cv2.NORM_L2, left, right)


def orb(left: Image, right: Image) -> Matches:
    """ORB with the ratio test."""
    return _by_ratio(cv2.ORB_create(nfeatures=MOST_POINTS), cv2.NORM_HAMMING, left, right)


def _by_ratio(detector: Any, norm: int, left: Image, right: Image) -> Matches:
    (first, one), (second, other) = (detector.detectAndCompute(_eight_bits(i), None) for i in (left, right))
    if one is None or other is None or len(second) < 2:
        return NOTHING
    near = cv2.BFMatcher(norm).knnMatch(one, other, k=2)
    kept = [two[0] for two in near if len(two) == 2 and two[0].distance < RATIO * two[1].distance]
    if not kept:
        return NOTHING
    return (
        np.array([first[m.queryIdx].pt for m in kept], dtype=np.float64),
        np.array([second[m.trainIdx].pt for m in kept], dtype=np.float64),
    )


def _eight_bits(image: Image) -> NDArray[np.uint8]:
    return image if image.dtype == np.uint8 else (image // 256).astype(np.uint8)
