"""The camera model against OpenCV's, triangulation against closed forms, its covariance against noise drawn anew."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vision_scene import FloatArray, paper_rig

from fsw.vision.rig import StereoRig, eyes_of, image_point
from fsw.vision.stereo import Points, make_points, triangulate_cells

LENS = (-0.12, 0.05, 6e-4, -4e-4, 0.01)


def corners_of(centre: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Corners (N, 4, 3) of flat cells with half sides u, v round their centres (N, 3)."""
    return centre[:, None] + np.array([-u - v, u - v, u + v, v - u])


def cells_in_view(count: int = 12) -> FloatArray:
    """Corners of tilted cells about where the optical axes cross."""
    rng = np.random.default_rng(2)
    centre = rng.uniform([-150.0, -120.0, 690.0], [150.0, 120.0, 760.0], (count, 3))
    return corners_of(centre, np.array([20.0, 1.0, -3.0]), np.array([-0.5, 9.0, 3.0]))


def triangulated(
    rig: StereoRig, corners: FloatArray, centre: FloatArray, covariance: FloatArray, matched: FloatArray | None = None
) -> Points:
    """Points of pixels (2, N, 4, 2), (2, N, 2), with covariance (2, N, 3)."""
    count = centre.shape[1]
    out = make_points(count)
    chosen = np.ones(count, bool) if matched is None else matched
    whole = np.ones(count, bool), np.ones(count, bool)
    triangulate_cells(eyes_of(rig), corners, centre, covariance, chosen, whole, out)
    return out


def pixels(rig: StereoRig, xyz: FloatArray) -> FloatArray:
    return np.stack([rig.project_ideal(eye, xyz) for eye in (0, 1)])


def unit(count: int, variance_px2: float = 1.0) -> FloatArray:
    return np.tile([variance_px2, 0.0, variance_px2], (2, count, 1))


@pytest.mark.parametrize("eye", [0, 1])
def test_the_lens_is_opencvs_and_its_inverse_takes_it_back(eye: int) -> None:
    rig = paper_rig(2048, LENS)
    xyz = np.random.default_rng(1).uniform([-250, -180, 680], [250, 180, 760], (200, 3))
    turn, _ = cv2.Rodrigues(rig.rotation[eye])
    reference, _ = cv2.projectPoints(xyz, turn, rig.translation_mm[eye], rig.matrix(eye), rig.distortion[eye])
    ideal = rig.project_ideal(eye, xyz)
    seen = rig.distort(eye, ideal)
    assert seen == pytest.approx(reference[:, 0], abs=1e-8)
    assert rig.undistort(eye, seen) == pytest.approx(ideal, abs=1e-8)


def test_a_point_behind_an_eye_has_no_pixel() -> None:
    assert np.isnan(paper_rig().project_ideal(0, np.array([[10.0, 5.0, -700.0], [1.0, 1.0, 0.0]]))).all()


def test_a_strong_lens_does_not_fold_far_points_back_into_the_image() -> None:
    rig = paper_rig(1024, (-0.3, 0.0, 0.0, 0.0, 0.0))
    eyes = eyes_of(rig)
    width, height = rig.size[0]
    middle = rig.intrinsics[0, 2:]
    for angle in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False):
        way = np.array([np.cos(angle), np.sin(angle)])
        was_inside = True
        for reach in np.linspace(0.0, 6000.0, 600):
            u, v = middle + reach * way
            inside, x, y = image_point(eyes, 0, u, v)
            assert not (inside and not was_inside), (angle, reach)  # once out of the image, out for good
            was_inside = inside
            if inside:
                assert 0.0 <= x <= width - 1 and 0.0 <= y <= height - 1
        assert not was_inside
    folded = rig.distort(0, middle + np.array([[2000.0, 0.0]]))  # the polynomial alone would show it
    assert 0.0 <= folded[0, 0] <= width - 1 and not image_point(eyes, 0, middle[0] + 2000.0, middle[1])[0]


def test_every_pixel_of_the_image_is_in_the_image() -> None:
    rig = paper_rig(1024, LENS)
    eyes = eyes_of(rig)
    rng = np.random.default_rng(4)
    for eye in (0, 1):
        for px in rng.uniform([0.5, 0.5], rig.size[eye] - 1.5, (300, 2)):
            inside, x, y = image_point(eyes, eye, *rig.undistort(eye, px))
            assert inside and (x, y) == pytest.approx(tuple(px), abs=1e-6)


def test_the_epipolar_constraint_holds_for_seen_points() -> None:
    rig = paper_rig()
    xyz = cells_in_view().mean(axis=1)
    left, right = (np.column_stack([px, np.ones(len(px))]) for px in pixels(rig, xyz))
    lines = left @ rig.fundamental().T
    distance = np.sum(lines * right, axis=1) / np.hypot(lines[:, 0], lines[:, 1])
    assert distance == pytest.approx(np.zeros(len(xyz)), abs=1e-8)
    centre = -rig.rotation[1].T @ rig.translation_mm[1]
    assert rig.baseline_mm == pytest.approx(np.linalg.norm(centre)) == pytest.approx(448.04, abs=0.05)


def test_without_noise_points_come_back_exactly() -> None:
    rig, corners = paper_rig(), cells_in_view()
    centre = corners.mean(axis=1)
    points = triangulated(rig, pixels(rig, corners), pixels(rig, centre), unit(len(corners)))
    assert points.valid.all()
    assert points.xyz_mm == pytest.approx(centre, abs=1e-7)
    assert np.abs(points.reprojection_px).max() < 1e-7 and np.abs(points.epipolar_px).max() < 1e-7


def test_the_epipolar_residual_is_the_signed_distance_from_the_line() -> None:
    rig, corners = paper_rig(), cells_in_view(5)
    both = pixels(rig, corners.mean(axis=1))
    lines = np.column_stack([both[0], np.ones(5)]) @ rig.fundamental().T
    normal = lines[:, :2] / np.hypot(lines[:, 0], lines[:, 1])[:, None]
    along = normal @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    for distance in (-0.7, 0.3):
        moved = both.copy()
        moved[1] += distance * normal + 5.0 * along
        points = triangulated(rig, pixels(rig, corners), moved, unit(5))
        assert points.epipolar_px == pytest.approx(np.full(5, distance), abs=1e-9)


def test_covariance_tells_the_scatter_under_noise() -> None:
    rig, corners = paper_rig(), cells_in_view(1)
    seen_corners, seen = pixels(rig, corners), pixels(rig, corners.mean(axis=1))
    covariance = np.array([[[0.02, 0.008, 0.01]], [[0.015, -0.004, 0.03]]])
    rng, draws = np.random.default_rng(8), 4000
    noise = np.stack([
        rng.multivariate_normal([0.0, 0.0], [[a, b], [b, c]], draws) for a, b, c in covariance[:, 0]
    ])  # fmt: skip
    # One cell a draw: its corners and its centre move together.
    points = triangulated(
        rig, np.ascontiguousarray(seen_corners + noise[:, :, None]), seen + noise, np.tile(covariance, (1, draws, 1))
    )
    scatter = np.cov(points.xyz_mm.T)
    told = points.covariance_mm2.mean(axis=0)
    ratio = np.linalg.eigvals(np.linalg.solve(scatter, told)).real
    assert ((ratio > 0.9) & (ratio < 1.1)).all(), ratio
    assert points.sigma_mm.mean() ** 2 == pytest.approx(np.trace(told), rel=1e-3)


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.01, 10.0))
def test_sigma_scales_with_the_pixels_noise(factor: float) -> None:
    rig, corners = paper_rig(), cells_in_view(3)
    both = pixels(rig, corners), pixels(rig, corners.mean(axis=1))
    one = triangulated(rig, *both, unit(3))
    other = triangulated(rig, *both, unit(3, factor**2))
    assert other.sigma_mm == pytest.approx(factor * one.sigma_mm, rel=1e-9)


def test_what_is_degenerate_is_not_valid_and_nothing_crashes() -> None:
    rig, corners = paper_rig(), cells_in_view(6)
    seen_corners, seen, covariance = pixels(rig, corners), pixels(rig, corners.mean(axis=1)), unit(6)
    seen_corners[0, 0] = seen[0, 0] = np.nan  # no pixels
    covariance[1, 1] = np.nan  # no weight
    covariance[0, 2] = 0.0  # said to be exact: its inverse is infinite
    matched = np.array([True, True, True, False, True, True])
    points = triangulated(rig, seen_corners, seen, covariance, matched)
    assert points.valid.tolist() == [False, False, False, False, True, True]
    assert np.isnan(points.xyz_mm[3]).all() and np.isnan(points.sigma_mm[3])
    assert np.isfinite(points.xyz_mm[4:]).all()


@pytest.mark.parametrize("disparity_px", [0.0, -20.0])
def test_rays_that_do_not_meet_before_the_eyes_give_no_valid_point(disparity_px: float) -> None:
    rig = paper_rig()
    shift = np.array([[0.0, 0.0, 0.0], [-100.0, 0.0, 0.0]])
    aside = StereoRig(rig.size, rig.intrinsics[[0, 0]], rig.distortion, np.stack([np.eye(3)] * 2), shift)
    both = np.stack([rig.intrinsics[0, 2:] + [30.0, 30.0], rig.intrinsics[0, 2:] + [30.0 - disparity_px, 30.0]])[
        :, None
    ]
    points = triangulated(aside, np.repeat(both[:, :, None], 4, axis=2), both, unit(1, 1e-4))
    assert not points.valid[0]


def test_a_hidden_side_moves_a_point_along_what_its_covariance_leaves_open() -> None:
    """In the right eye, side 0 is put half a pixel off along the sides that meet it: so much is not known there."""
    rig, corners = paper_rig(), cells_in_view(8)
    seen, centre = pixels(rig, corners), pixels(rig, corners.mean(axis=1))
    along = seen[1, :, [0, 1]] - seen[1, :, [3, 2]]
    slip = 0.5 * along / np.linalg.norm(along, axis=-1, keepdims=True)
    seen[1, :, 0] += slip[0]
    seen[1, :, 1] += slip[1]
    moved = 0.25 * slip.sum(axis=0)
    centre[1] += moved
    covariance = unit(8, 1e-6)
    covariance[1] += np.column_stack([moved[:, 0] ** 2, moved[:, 0] * moved[:, 1], moved[:, 1] ** 2])
    whole, out = np.ones(8, bool), make_points(8)
    triangulate_cells(eyes_of(rig), seen, centre, covariance, whole, (whole, ~whole), out)
    error = out.xyz_mm - corners.mean(axis=1)
    squares = np.einsum("ni,ni->n", error, np.linalg.solve(out.covariance_mm2, error[..., None])[..., 0])
    assert squares.max() < 0.05  # the other eye's pixels, which are right, outweigh them
    mean = triangulated(rig, seen, centre, covariance)  # of the corners
    assert out.between_mm == pytest.approx(mean.xyz_mm - out.xyz_mm, abs=1e-9)
    assert (mean.between_mm == 0.0).all()


def test_results_of_the_last_tick_do_not_linger() -> None:
    rig, corners = paper_rig(), cells_in_view(4)
    both = pixels(rig, corners), pixels(rig, corners.mean(axis=1))
    out = make_points(4)
    for matched in (np.ones(4, bool), np.zeros(4, bool)):
        triangulate_cells(eyes_of(rig), *both, unit(4), matched, (matched, matched), out)
    assert not out.valid.any()
    assert all(np.isnan(field).all() for field in out[:-1])
