"""The wing's natural modes: a thin plate, clamped at its root, with fold lines that act as rotational springs.

Kirchhoff plate with Bogner-Fox-Schmit elements (scikit-fem), one mesh a panel. At a fold line the displacement and its
slope along the line are shared; the slope across it is not, and a spring joins the two sides.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh
from skfem import Basis, BilinearForm, ElementQuadBFS, MeshQuad
from skfem.helpers import dd, ddot, eye, trace

from sim.surface import heights, make_patches

FloatArray = NDArray[np.float64]

_MM = 1e-3
_W, _W_X, _W_Y, _W_XY = range(4)  # degrees of freedom of a Bogner-Fox-Schmit node


@dataclass(frozen=True)
class Plate:
    """A wing: size and thickness in mm, positions of its fold lines along X, Young's modulus, density, Poisson's ratio.

    hinge_nm_per_rad: stiffness of a whole fold line; infinite means no fold.
    """

    length_mm: float
    width_mm: float
    thickness_mm: float
    folds_mm: tuple[float, ...]
    youngs_gpa: float
    density_kg_m3: float
    poisson: float
    hinge_nm_per_rad: float


@dataclass(frozen=True)
class Modes:
    """Mass-normalised modes in order of frequency, as surfaces over the wing.

    frequency_hz (M,); patches (M, ex, ey, 4, 4) on element borders x_mm, y_mm, in kg^-1/2; tip (M,): largest value on
    the free end, positive: a modal coordinate of a / tip moves the tip by a.
    """

    frequency_hz: FloatArray
    patches: FloatArray
    x_mm: FloatArray
    y_mm: FloatArray
    tip: FloatArray

    def surface(self, tip_amplitude_mm: FloatArray) -> FloatArray:
        """Patches (ex, ey, 4, 4) in mm of the wing bent by this displacement (M,) of its tip in each mode."""
        return np.ascontiguousarray(np.tensordot(tip_amplitude_mm / self.tip, self.patches, axes=1))

    def shapes(self, points_mm: FloatArray) -> FloatArray:
        """w, w_x, w_y (M, P, 3) of each mode at wing points (P, 2); slopes per mm."""
        return np.stack([heights(p, self.x_mm, self.y_mm, points_mm) for p in self.patches])


def solve_modes(plate: Plate, count: int, elements_x: int = 24, elements_y: int = 6) -> Modes:
    """The first `count` modes of the plate; elements_x are shared out among the panels by their length."""
    hinged = np.isfinite(plate.hinge_nm_per_rad)
    borders = np.array([0.0, *(plate.folds_mm if hinged else ()), plate.length_mm]) * _MM
    y = np.linspace(-0.5, 0.5, elements_y + 1) * plate.width_mm * _MM
    panels = [np.linspace(a, b, max(2, round(elements_x * (b - a) / borders[-1])) + 1) for a, b in pairwise(borders)]
    blocks = [_panel_matrices(plate, x, y) for x in panels]
    stiffness = sparse.block_diag([k for k, _, _ in blocks], format="lil")
    mass = sparse.block_diag([m for _, m, _ in blocks], format="csc")
    offsets = np.cumsum([0, *(len(k_m_dofs[2].ravel()) for k_m_dofs in blocks)])
    dofs = [d + offset for (_, _, d), offset in zip(blocks, offsets[:-1], strict=True)]

    tie = np.arange(offsets[-1])
    for left, right in pairwise(dofs):
        for kind in (_W, _W_Y):
            tie[right[0, :, kind]] = left[-1, :, kind]
        _add_fold(stiffness, left[-1], right[0], plate.hinge_nm_per_rad / (y[-1] - y[0]), np.diff(y))
    tie[dofs[0][0].ravel()] = -1
    free = np.unique(tie[tie >= 0])
    kept = np.flatnonzero(tie >= 0)
    places = (kept, np.searchsorted(free, tie[kept]))
    expand = sparse.csc_matrix((np.ones(len(kept)), places), shape=(len(tie), len(free)))
    values, vectors = _lowest(expand.T @ stiffness.tocsc() @ expand, expand.T @ mass @ expand, count)
    vectors = expand @ vectors

    patches = np.concatenate([_patches(vectors[d], x, y) for d, x in zip(dofs, panels, strict=True)], axis=1)
    x_mm = np.concatenate([panels[0], *(x[1:] for x in panels[1:])]) / _MM
    ends = vectors[dofs[-1][-1, :, _W]]
    tip = ends[np.abs(ends).argmax(axis=0), np.arange(count)]
    sign = np.sign(tip)
    return Modes(
        frequency_hz=np.sqrt(values) / (2.0 * np.pi),
        patches=patches * sign[:, None, None, None, None],
        x_mm=x_mm,
        y_mm=y / _MM,
        tip=tip * sign,
    )


def _lowest(stiffness: sparse.csc_matrix, mass: sparse.csc_matrix, count: int) -> tuple[FloatArray, FloatArray]:
    """Lowest eigenvalues and their mass-normalised vectors. A fixed start makes them the same every time."""
    # The start is neither even nor odd across the wing, or else torsion would never be found.
    start = np.linspace(1.0, 2.0, stiffness.shape[0])
    values, vectors = eigsh(stiffness, count, mass, sigma=0.0, v0=start)
    order = np.argsort(values)
    return values[order], vectors[:, order]


def _panel_matrices(
    plate: Plate, x: FloatArray, y: FloatArray
) -> tuple[sparse.csr_matrix, sparse.csr_matrix, NDArray[np.int64]]:
    """Stiffness, mass, and the numbers of the degrees of freedom (x node, y node, kind) of one panel."""
    thickness, nu = plate.thickness_mm * _MM, plate.poisson
    rigidity = plate.youngs_gpa * 1e9 * thickness**3 / (12.0 * (1.0 - nu**2))

    @BilinearForm
    def bending(w, v, _):  # type: ignore[no-untyped-def]  # scikit-fem's form arguments have no public type
        moment = rigidity * ((1.0 - nu) * dd(w) + nu * eye(trace(dd(w)), 2))
        return ddot(moment, dd(v))

    @BilinearForm
    def inertia(w, v, _):  # type: ignore[no-untyped-def]
        return plate.density_kg_m3 * thickness * w * v

    mesh = MeshQuad.init_tensor(x, y)
    basis = Basis(mesh, ElementQuadBFS(), intorder=8)
    order = np.lexsort((mesh.p[1], mesh.p[0]))
    dofs = basis.nodal_dofs[:, order].T.reshape(len(x), len(y), 4)
    return bending.assemble(basis), inertia.assemble(basis), dofs.astype(np.int64)


def _add_fold(
    stiffness: sparse.lil_matrix,
    left: NDArray[np.int64],
    right: NDArray[np.int64],
    spring: float,
    sizes: FloatArray,
) -> None:
    """Add a fold line's energy 1/2 int spring (w_x,right - w_x,left)^2 dY; left, right (ny, 4), spring per metre."""
    for j, h in enumerate(sizes):
        ends = [(j, _W_X), (j, _W_XY), (j + 1, _W_X), (j + 1, _W_XY)]
        numbers = np.array([[side[n, kind] for n, kind in ends] for side in (right, left)]).ravel()
        # The slope across the fold is a Hermite cubic along it, so this is the consistent matrix of a beam element.
        line = np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
            ]
        )
        stiffness[np.ix_(numbers, numbers)] += np.kron([[1, -1], [-1, 1]], line) * spring * h / 420.0


def _patches(nodal: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Patches (M, ex, ey, 4, 4) of modes whose nodal values (x node, y node, kind, M) are given."""
    values = np.moveaxis(nodal, -1, 0)
    corners = np.stack(
        [
            np.stack([values[:, :-1, :-1], values[:, :-1, 1:]], axis=3),
            np.stack([values[:, 1:, :-1], values[:, 1:, 1:]], axis=3),
        ],
        axis=3,
    )
    size = np.stack(np.meshgrid(np.diff(x), np.diff(y), indexing="ij"), axis=-1)
    return make_patches(corners, size)
