"""Bundle adjustment of a two-camera rig over views of one board.

Unknowns are the interior orientation and lens of both cameras, the pose of the right camera in the left one, optionally the shape
of the board, and one board pose per pair; a pair that only one camera sees counts for that camera. Levenberg-Marquardt; board
poses are eliminated pair by pair (Schur complement; Brown 1958, Triggs et al. 2000). Metres, pixels, radians.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from conetl.geometry import pose as se3
from conetl.geometry.camera import intrinsics, project, project_with_jacobian
from conetl.geometry.small_arrays import apply_steps, cross_matrix
from conetl.model.arrays import Bools, Floats, Ints
from conetl.model.rig import INTERIOR, LENS_COEFFICIENTS, RELATIVE, SIDES, Camera, Lens, LensModel, Side

PairSystem = tuple[Floats, Floats, Floats]
#: Prior sigmas of a free board's shape, as a share of its diagonal: paper and plates buckle, but are printed well. Without them
#: the aspect ratios of a board that is always upright and of the pixels could not be separated.
SHAPE_SIGMA_ACROSS = 0.001
SHAPE_SIGMA_OUT_OF_PLANE = 0.01
#: A step that changes the sum of squares by less than this share ends the iteration.
_CONVERGENCE = 1e-9
_LIGHT = 1e-3
_MAX_ITERATIONS = 60


@dataclass(frozen=True)
class BoardView:
    """The corners of the board that one image shows.

    point_ids: (n,) row numbers in the board's points. uv_px: (n, 2), origin at the centre of the top-left pixel.
    """

    pair_index: int
    side: Side
    point_ids: Ints
    uv_px: Floats

    def only(self, keep: Bools) -> BoardView:
        """The view with the corners of the mask `keep` (n,)."""
        return BoardView(self.pair_index, self.side, self.point_ids[keep], self.uv_px[keep])


def shape_basis(points_m: ArrayLike) -> Floats:
    """Orthonormal basis (3n, 3n - 7) of the deformations of n board points (n, 3) that no rigid motion and no scale explains.

    A board's shape and its poses are only determined together up to a similarity; these are the inner constraints of a free
    network (Meissl), with the mean scale held by the nominal points.
    """
    p = np.asarray(points_m, dtype=np.float64)
    centred = p - p.mean(axis=0)
    motions = [*(np.tile(axis, (len(p), 1)) for axis in np.eye(3)), *cross_matrix(centred).swapaxes(0, 1), centred]
    datum = np.stack([m.ravel() for m in motions], axis=1)
    q, _ = np.linalg.qr(datum, mode="complete")
    return np.ascontiguousarray(q[:, 7:])


def pair_indices(views: Iterable[BoardView]) -> list[int]:
    """Numbers of all pairs with a view, ascending."""
    return sorted({view.pair_index for view in views})


def stereo_pairs(views: Sequence[BoardView]) -> list[int]:
    """Numbers of the pairs of which both cameras have a view, ascending."""
    left, right = ({view.pair_index for view in views if view.side == side} for side in SIDES)
    return sorted(left & right)


class BundleError(ValueError):
    """The adjustment has no answer: not converged, or the images do not determine the unknowns."""


@dataclass(frozen=True)
class Bundle:
    """All unknowns of the adjustment. board_SE3: poses left_SE3_board (4, 4) by pair. shape: (m,) coordinates of the board's
    deformation in `basis` (3n, m); m = 0 if the board's nominal points are exact."""

    left: Camera
    right: Camera
    left_SE3_right: Floats
    board_SE3: dict[int, Floats]
    points_m: Floats
    basis: Floats
    shape: Floats
    sigma_px: float = 0.1
    """Of one image coordinate: the weight of the prior of the board's shape is relative to it."""

    @property
    def lens_model(self) -> LensModel:
        return self.left.lens.model

    @property
    def rig_parameters(self) -> int:
        """Number of unknowns of the rig; the board's shape follows them in the global system."""
        return 2 * (len(INTERIOR) + LENS_COEFFICIENTS[self.lens_model]) + len(RELATIVE)

    def board_points_m(self) -> Floats:
        """(n, 3) points of the board with its deformation."""
        return np.asarray(self.points_m + (self.basis @ self.shape).reshape(-1, 3))


class Reduced(NamedTuple):
    """The system without board poses: each pair's share of the normal matrix (p, g, g) and of its right side (p, g)."""

    normals: Floats
    gradients: Floats
    prior: Floats
    """(g, g) normal matrix of the prior of the board's shape."""

    @property
    def normal(self) -> Floats:
        """(g, g) reduced normal matrix."""
        return np.asarray(self.normals.sum(axis=0) + self.prior)


def parameter_names(model: LensModel) -> tuple[str, ...]:
    """Names of the rig's unknowns in the order of the adjustment, those of `CalibrationCovariance`."""
    own = (*INTERIOR, *(f"lens.{i}" for i in range(LENS_COEFFICIENTS[model])))
    return (*(f"{side}.{name}" for side in SIDES for name in own), *(f"relative.{name}" for name in RELATIVE))


def residuals_px(bundle: Bundle, view: BoardView) -> Floats:
    """(n, 2) observed minus computed image points of one view. Raises BundleError where a corner is behind the camera."""
    camera = bundle.left if view.side == "left" else bundle.right
    points = bundle.board_points_m()[view.point_ids]
    in_camera = se3.apply(bundle.board_SE3[view.pair_index], points)
    if view.side == "right":
        in_camera = se3.apply(se3.invert(bundle.left_SE3_right), in_camera)
    if not np.all(in_camera[:, 2] > 0):
        raise BundleError("a corner of the board lies behind the camera")
    return np.asarray(view.uv_px - project(camera, in_camera))


def adjust(bundle: Bundle, views: Sequence[BoardView], *, weights: Sequence[Floats] | None = None) -> Bundle:
    """The bundle of least weighted squares, from a bundle nearby.

    weights: (n,) for the corners of each view, default one. Raises BundleError where it does not converge.
    """
    by_pair = _by_pair(views, weights)
    damping = 1e-3
    prior = _prior(bundle)
    best = _cost(bundle, prior, by_pair)
    for _ in range(_MAX_ITERATIONS):
        systems = {pair: pair_system(bundle, parts) for pair, parts in by_pair.items()}
        while True:
            trial = _stepped(bundle, systems, prior, damping)
            cost = _cost_or_inf(trial, prior, by_pair)
            if cost <= best:
                break
            damping *= 10.0
            if damping > 1e10:
                return bundle  # no step reduces the cost: the minimum within rounding
        gain = best - cost
        if gain < _CONVERGENCE * best and damping > _LIGHT:
            # a heavily damped step is always short: converged only if the full step gains nothing either
            full = _stepped(bundle, systems, prior, 0.0)
            gain = max(gain, best - _cost_or_inf(full, prior, by_pair))
            damping = _LIGHT
        done = gain < _CONVERGENCE * best
        bundle, best, damping = trial, cost, max(damping * 0.1, 1e-12)
        if done:
            return bundle
    raise BundleError(
        f"the adjustment did not converge in {_MAX_ITERATIONS} iterations: the board was seen in too few or too similar positions"
    )


def reduce(bundle: Bundle, views: Sequence[BoardView]) -> Reduced:
    """The linearised system at a bundle, with the board poses eliminated."""
    normals, gradients = [], []
    for parts in _by_pair(views, None).values():
        r, a, b = pair_system(bundle, parts)
        inner = np.linalg.solve(b.T @ b, np.column_stack([b.T @ a, b.T @ r]))
        free = np.column_stack([a, r]) - b @ inner  # the part that the board pose does not explain
        normals.append(free[:, :-1].T @ free[:, :-1])
        gradients.append(free[:, :-1].T @ free[:, -1])
    return Reduced(np.array(normals), np.array(gradients), _prior(bundle))


def pair_system(bundle: Bundle, parts: Sequence[tuple[BoardView, Floats]]) -> PairSystem:
    """Residuals (r,) px of the views of one pair in the linearised system, Jacobians of the global (r, g) and the pose unknowns
    (r, 6); rows are scaled by the square roots of the weights."""
    pose = bundle.board_SE3[parts[0][0].pair_index]
    points = bundle.board_points_m()
    count = bundle.rig_parameters
    own = (count - len(RELATIVE)) // 2
    rows_r, rows_a, rows_b = [], [], []
    for view, weight in parts:
        turned = points[view.point_ids] @ pose[:3, :3].T
        in_left = turned + pose[:3, 3]
        a = np.zeros((len(in_left), 2, count + len(bundle.shape)))
        if view.side == "left":
            camera, in_camera, camera_R_left, first = bundle.left, in_left, np.eye(3), 0
        else:
            right_SE3_left = se3.invert(bundle.left_SE3_right)
            camera_R_left, first = right_SE3_left[:3, :3], own
            camera, in_camera = bundle.right, se3.apply(right_SE3_left, in_left)
        seen = project_with_jacobian(camera, in_camera)
        a[:, :, first : first + own] = seen.by_interior
        by_left_point = seen.by_point @ camera_R_left
        if view.side == "right":
            # left_SE3_right = (R exp(r), t + dt): x_right changes by x_right x r - R^T dt
            a[:, :, count - 6 : count - 3] = seen.by_point @ cross_matrix(in_camera)
            a[:, :, count - 3 : count] = -by_left_point
        if len(bundle.shape):
            freedom = bundle.basis.reshape(-1, 3, len(bundle.shape))[view.point_ids]
            a[:, :, count:] = by_left_point @ pose[:3, :3] @ freedom
        b = np.concatenate([-by_left_point @ cross_matrix(turned), by_left_point], axis=2)
        root = np.sqrt(weight)[:, None]
        rows_r.append(((view.uv_px - seen.uv_px) * root).ravel())
        rows_a.append((a * root[..., None]).reshape(-1, a.shape[2]))
        rows_b.append((b * root[..., None]).reshape(-1, 6))
    return np.concatenate(rows_r), np.concatenate(rows_a), np.concatenate(rows_b)


# --------------------------------------------------------------------------- steps


def _stepped(bundle: Bundle, systems: dict[int, PairSystem], prior: Floats, damping: float) -> Bundle:
    size = bundle.rig_parameters + len(bundle.shape)
    normal, right = prior.copy(), np.zeros(size)
    first = bundle.rig_parameters
    right[first:] = -prior[first:, first:] @ bundle.shape
    kept = {}
    diagonal = np.diag(prior) + sum((a**2).sum(axis=0) for _, a, _ in systems.values())
    for pair, (r, a, b) in systems.items():
        v = b.T @ b
        v[np.diag_indices(6)] *= 1.0 + damping
        w, gradient = b.T @ a, b.T @ r
        inner = np.linalg.solve(v, np.column_stack([w, gradient]))
        normal += a.T @ a - w.T @ inner[:, :-1]
        right += a.T @ r - w.T @ inner[:, -1]
        kept[pair] = inner
    normal[np.diag_indices(size)] += damping * diagonal
    scale = 1.0 / np.sqrt(np.maximum(diagonal, 1e-300))  # unknowns of very different units
    try:
        step = scale * np.linalg.solve(normal * scale[:, None] * scale, scale * right)
    except np.linalg.LinAlgError as error:
        raise BundleError("the images do not determine the calibration: singular normal equations") from error
    poses = {pair: inner[:, -1] - inner[:, :-1] @ step for pair, inner in kept.items()}
    return apply_step(bundle, step, poses)


def apply_step(bundle: Bundle, step: Floats, pose_steps: dict[int, Floats]) -> Bundle:
    """The bundle after a step (g,) of the global unknowns and (6,) steps of the board poses (rotation vector, shift)."""
    count = bundle.rig_parameters
    own = (count - len(RELATIVE)) // 2
    r, t = bundle.left_SE3_right[:3, :3], bundle.left_SE3_right[:3, 3]
    relative = se3.se3(r @ Rotation.from_rotvec(step[count - 6 : count - 3]).as_matrix(), t + step[count - 3 : count])
    poses = bundle.board_SE3 | {pair: apply_steps(bundle.board_SE3[pair], d) for pair, d in pose_steps.items()}
    return replace(
        bundle,
        left=_step_camera(bundle.left, step[:own]),
        right=_step_camera(bundle.right, step[own : 2 * own]),
        left_SE3_right=relative,
        board_SE3=poses,
        shape=bundle.shape + step[count:],
    )


def _step_camera(camera: Camera, step: Floats) -> Camera:
    fx, fy, cx, cy = (intrinsics(camera) + step[:4]).tolist()
    coefficients = tuple((np.array(camera.lens.coefficients) + step[4:]).tolist())
    lens = Lens.model_construct(model=camera.lens.model, coefficients=coefficients)
    # unchecked: a trial step may be invalid; its cost is infinite then and the step is rejected
    return camera.model_copy(update={"fx_px": fx, "fy_px": fy, "cx_px": cx, "cy_px": cy, "lens": lens})


def _prior(bundle: Bundle) -> Floats:
    """(g, g): no prior of the rig; one of the board's shape, independent for each corner."""
    first = bundle.rig_parameters
    prior = np.zeros((first + len(bundle.shape),) * 2)
    if len(bundle.shape):
        diagonal_m = float(np.linalg.norm(np.ptp(bundle.points_m, axis=0)))
        sigmas_m = diagonal_m * np.array([SHAPE_SIGMA_ACROSS, SHAPE_SIGMA_ACROSS, SHAPE_SIGMA_OUT_OF_PLANE])
        weighed = bundle.basis * np.tile(bundle.sigma_px / sigmas_m, len(bundle.points_m))[:, None]
        prior[first:, first:] = weighed.T @ weighed
    return prior


def _cost(bundle: Bundle, prior: Floats, by_pair: dict[int, list[tuple[BoardView, Floats]]]) -> float:
    first = bundle.rig_parameters
    total = float(bundle.shape @ prior[first:, first:] @ bundle.shape)
    for parts in by_pair.values():
        for view, weight in parts:
            total += float((weight[:, None] * residuals_px(bundle, view) ** 2).sum())
    return total


def _cost_or_inf(bundle: Bundle, prior: Floats, by_pair: dict[int, list[tuple[BoardView, Floats]]]) -> float:
    if not all(f > 0 for c in (bundle.left, bundle.right) for f in (c.fx_px, c.fy_px)):
        return float("inf")
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            cost = _cost(bundle, prior, by_pair)
    except BundleError:
        return float("inf")
    return cost if np.isfinite(cost) else float("inf")


def _by_pair(views: Sequence[BoardView], weights: Sequence[Floats] | None) -> dict[int, list[tuple[BoardView, Floats]]]:
    found: dict[int, list[tuple[BoardView, Floats]]] = defaultdict(list)
    for number, view in enumerate(views):
        weight = np.ones(len(view.point_ids)) if weights is None else weights[number]
        found[view.pair_index].append((view, weight))
    return dict(sorted(found.items()))
