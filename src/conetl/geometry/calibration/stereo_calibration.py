"""Calibration of a two-camera rig from board views and start values: robust adjustment, choice of the model, covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from conetl.geometry import pose as se3
from conetl.geometry.calibration.covariance import RigCovariance, change_over_pairs, rig_covariance
from conetl.geometry.calibration.stereo_bundle import (
    BoardView,
    Bundle,
    BundleError,
    adjust,
    pair_indices,
    parameter_names,
    reduce,
    residuals_px,
    shape_basis,
    stereo_pairs,
)
from conetl.geometry.lens import distort, distort_jacobian, undistort
from conetl.geometry.packing import as_rows
from conetl.model.arrays import Floats
from conetl.model.rig import LENS_COEFFICIENTS, SIDES, CalibrationCovariance, Camera, Lens, LensModel, Rig, Side

BoardShape = Literal["flat", "free"]
MODELS: tuple[LensModel, ...] = ("none", "radial", "brown", "rational", "fisheye")
#: Pairs that both cameras must see.
MIN_PAIRS = 3
#: Corners farther off than this many robust sigmas are removed (a normal error once in 25,000).
CORNER_LIMIT = 4.5
#: A view is removed where its RMS is this many times that of the median view, or where it loses half of its corners.
VIEW_LIMIT = 3.5
#: Start: a pair whose own relative orientation moves the corners by more than this share of the image's width is left out.
PAIR_LIMIT_RELATIVE = 0.05
#: `change_over_pairs` above which the rig has changed. 40 real pairs have 1.4 as they were taken, and up to 4.7 in 100 random
#: orders; 51 to 209 after the right camera was moved by 1 or 3 px, turned by 0.5 degrees or zoomed by 1 % for the second half.
CHANGE_LIMIT = 8.0
#: With fewer pairs their scatter is not known well enough to tell.
CHANGE_PAIRS = 16
#: A view with fewer corners is not used.
MIN_CORNERS = 6
_HUBER = 2.5
_MAX_ROUNDS = 8


class Start(NamedTuple):
    """Start values: cameras (any lens model) and board poses camera_SE3_board (4, 4) by side and pair."""

    left: Camera
    right: Camera
    left_SE3_board: dict[int, Floats]
    right_SE3_board: dict[int, Floats]


class CornerRejection(NamedTuple):
    """One corner that was removed, with its residual (observed minus computed, px)."""

    pair_index: int
    side: Side
    point_id: int
    uv_px: tuple[float, float]
    residual_px: tuple[float, float]


class ViewRejection(NamedTuple):
    """One image that was removed, and why."""

    pair_index: int
    side: Side
    detail: str


class Candidate(NamedTuple):
    """One model that was tried. bic: lower is better; None with the reason in `problem` where the model cannot be used."""

    model: LensModel
    board: BoardShape
    parameters: int
    rms_px: float | None
    bic: float | None
    problem: str | None


@dataclass(frozen=True)
class StereoCalibration:
    """The result, with the views used and what was removed."""

    bundle: Bundle
    board_shape: BoardShape
    views: tuple[BoardView, ...]
    covariance: RigCovariance
    variance_factor_px2: float
    degrees_of_freedom: int
    rejected_views: tuple[ViewRejection, ...]
    rejected_corners: tuple[CornerRejection, ...]
    candidates: tuple[Candidate, ...]

    @property
    def stereo_pairs(self) -> list[int]:
        """Pairs that both cameras see."""
        return stereo_pairs(self.views)

    @property
    def is_constancy_checked(self) -> bool:
        """Whether there were enough pairs to see that the rig changed meanwhile; if it did, there is no calibration."""
        return len(pair_indices(self.views)) >= CHANGE_PAIRS


def calibrate_stereo(
    points_m: Floats,
    views: Sequence[BoardView],
    start: Start,
    *,
    models: Sequence[LensModel] = MODELS,
    board_shapes: Sequence[BoardShape] = ("flat", "free"),
) -> StereoCalibration:
    """Calibrate a rig with the lens model and board shape of the lowest BIC.

    points_m: (n, 3) nominal board. board_shapes: "flat" uses the nominal board, "free" estimates its shape as well. The
    information criterion assumes independent observations: their number and the sum of squares are divided by the design effect
    of the richest model (see `rig_covariance`). Raises BundleError.
    """
    bundle, kept, rejected = _initial_bundle(np.asarray(points_m, dtype=np.float64), views, start)
    # Blunders are found with a flexible model, so that good corners of a distorted lens or bent board are kept.
    first: LensModel = models[0] if len(models) == 1 else "brown"
    richest: BoardShape = "free" if "free" in board_shapes else "flat"
    bundle, kept, more, corners = _adjust_robustly(_convert(bundle, first, richest), kept)
    covariance, factor, _ = _covariance_of(bundle, kept)
    scale = factor * max(covariance.design_effect, 1.0)
    shape = richest
    tried: dict[tuple[LensModel, BoardShape], tuple[Candidate, Bundle | None]] = {}
    if len(board_shapes) > 1:
        tried = {(first, option): _try_model(bundle, kept, first, option, scale, factor) for option in board_shapes}
        shape = min(board_shapes, key=lambda option: _bic_or_inf(tried[first, option][0]))
    for model in models:
        if (model, shape) not in tried:
            tried[model, shape] = _try_model(bundle, kept, model, shape, scale, factor)
    candidates = tuple(candidate for candidate, _ in tried.values())
    best, chosen = min((tried[model, shape] for model in models), key=lambda pair: _bic_or_inf(pair[0]))
    if chosen is None:
        reasons = "; ".join(f"{c.model}: {c.problem}" for c in candidates if c.problem)
        raise BundleError(f"no lens model fits the images ({reasons})")
    covariance, factor, freedom = _covariance_of(chosen, kept)
    _check_constancy(chosen, kept, factor)
    return StereoCalibration(
        chosen, best.board, tuple(kept), covariance, factor, freedom, (*rejected, *more), corners, candidates
    )


def rig_of(calibration: StereoCalibration, rig_id: str, *, scale_sigma_relative: float = 0.0) -> Rig:
    """The calibrated rig with its covariance; the body is the left camera.

    scale_sigma_relative: standard deviation of the board's size as a share; it is the baseline's as well.
    """
    bundle = calibration.bundle
    matrix = calibration.covariance.matrix.copy()
    along = np.zeros(len(matrix))
    along[-3:] = bundle.left_SE3_right[:3, 3]
    matrix += scale_sigma_relative**2 * np.outer(along, along)
    return Rig(
        rig_id=rig_id,
        left=Camera.model_validate(bundle.left.model_dump()),
        right=Camera.model_validate(bundle.right.model_dump()),
        body_SE3_left=se3.to_matrix4(np.eye(4)),
        body_SE3_right=se3.to_matrix4(bundle.left_SE3_right),
        calibration_covariance=CalibrationCovariance(names=parameter_names(bundle.lens_model), matrix=as_rows(matrix)),
    )


# --------------------------------------------------------------------------- start


def _initial_bundle(
    points_m: Floats, views: Sequence[BoardView], start: Start
) -> tuple[Bundle, list[BoardView], list[ViewRejection]]:
    """A first bundle in one frame, without the pairs whose two images contradict those of the others."""
    by_key = {(view.pair_index, view.side): view for view in views}
    both = stereo_pairs(views)
    if len(both) < MIN_PAIRS:
        raise BundleError(
            f"{len(both)} pairs show the board in both images, at least {MIN_PAIRS} are needed (20 to 40 are good): "
            "take more pairs, near and far, tilted, and into the corners of the images"
        )
    relatives = {p: se3.compose(start.left_SE3_board[p], se3.invert(start.right_SE3_board[p])) for p in both}
    relative = _medoid(np.array([relatives[p] for p in both]))
    as_drawn = np.zeros((points_m.size, 0))
    bundle = Bundle(start.left, start.right, relative, dict(start.left_SE3_board), points_m, as_drawn, np.zeros(0))
    rejected: list[ViewRejection] = []
    for p in both:
        seen = by_key[p, "right"]
        try:
            miss = float(np.sqrt((residuals_px(bundle, seen) ** 2).sum(axis=1).mean()))
        except BundleError:
            miss = float("inf")
        if miss > PAIR_LIMIT_RELATIVE * start.right.width_px:
            text = (
                f"left and right image contradict the other pairs by {miss:.0f} px: not the same instant, another board, "
                "or the rig was touched"
            )
            rejected += [ViewRejection(p, side, text) for side in SIDES]
    refused = {r.pair_index for r in rejected}
    if len(both) - len(refused) < max(MIN_PAIRS, len(both) / 3):
        raise BundleError(
            f"only {len(both) - len(refused)} of {len(both)} pairs agree on where the right camera is: check that left and right "
            "images are paired as they were taken, and that board size and pattern are those of the board"
        )
    poses = {p: relative @ pose for p, pose in start.right_SE3_board.items()} | start.left_SE3_board
    kept = [view for view in views if view.pair_index not in refused]
    used = set(pair_indices(kept))
    return replace(bundle, board_SE3={p: pose for p, pose in poses.items() if p in used}), kept, rejected


def _medoid(poses: Floats) -> Floats:
    """The pose of (n, 4, 4) with the least median distance to the others."""
    turns = np.einsum("aij,bij->ab", poses[:, :3, :3], poses[:, :3, :3])
    angles = np.arccos(np.clip((turns - 1.0) / 2.0, -1.0, 1.0))
    shifts = np.linalg.norm(poses[:, None, :3, 3] - poses[None, :, :3, 3], axis=2)
    size = max(float(np.median(np.linalg.norm(poses[:, :3, 3], axis=1))), 1e-9)
    return np.asarray(poses[int(np.argmin(np.median(angles + shifts / size, axis=1)))])


def _convert(bundle: Bundle, model: LensModel, shape: BoardShape) -> Bundle:
    """The bundle with another lens model, fitted to the old one over the image, and another board shape."""
    basis = shape_basis(bundle.points_m) if shape == "free" else np.zeros((bundle.points_m.size, 0))
    start = bundle.shape if bundle.shape.size == basis.shape[1] else np.zeros(basis.shape[1])
    left, right = (
        camera.model_copy(update={"lens": _fit_lens(camera, model)}) for camera in (bundle.left, bundle.right)
    )
    return replace(bundle, left=left, right=right, basis=basis, shape=start)


def _fit_lens(camera: Camera, model: LensModel) -> Lens:
    """Lens of another model that is nearest to a camera's own over its image."""
    if camera.lens.model == model:
        return camera.lens
    family: LensModel = "brown" if model == "rational" else model  # the rational one begins as its numerator
    blank = Lens(model=family, coefficients=(0.0,) * LENS_COEFFICIENTS[family])
    bent = _grid(camera, 25)
    ideal = undistort(camera.lens, bent)
    good = np.isfinite(ideal).all(axis=1)
    fitted: Floats
    if family == "none" or good.sum() < 25:
        fitted = np.zeros(LENS_COEFFICIENTS[family])
    else:
        _, by_k = distort_jacobian(blank, ideal[good])  # these models are linear in their coefficients
        wanted = (bent[good] - distort(blank, ideal[good])).ravel()
        fitted = np.asarray(np.linalg.lstsq(by_k.reshape(-1, by_k.shape[2]), wanted)[0], dtype=np.float64)
    padded = (*(float(k) for k in fitted), *(0.0,) * (LENS_COEFFICIENTS[model] - len(fitted)))
    return Lens(model=model, coefficients=padded)


def _grid(camera: Camera, steps: int) -> Floats:
    """(steps^2, 2) normalised, distorted coordinates spread over the image, edges included."""
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, steps), np.linspace(0, camera.height_px - 1, steps))
    return np.stack([(u.ravel() - camera.cx_px) / camera.fx_px, (v.ravel() - camera.cy_px) / camera.fy_px], axis=1)


# --------------------------------------------------------------------------- blunders


def _adjust_robustly(
    bundle: Bundle, views: Sequence[BoardView]
) -> tuple[Bundle, list[BoardView], tuple[ViewRejection, ...], tuple[CornerRejection, ...]]:
    """Adjusted bundle, remaining views, and the views and corners that were removed.

    Huber's weights find the solution of most corners; corners and views beyond the limits are then removed and the rest adjusted
    with equal weights, until nothing changes.
    """
    kept = list(views)
    weights = [np.ones(len(v.point_ids)) for v in kept]
    for _ in range(3):
        bundle = adjust(bundle, kept, weights=weights)
        misses = [np.hypot(*residuals_px(bundle, v).T) for v in kept]
        sigma = _robust_sigma(misses)
        bundle = replace(bundle, sigma_px=sigma)
        weights = [np.minimum(1.0, _HUBER * sigma / np.maximum(m, 1e-12)) for m in misses]
    rejected: list[ViewRejection] = []
    for _ in range(_MAX_ROUNDS):
        misses = [np.hypot(*residuals_px(bundle, v).T) for v in kept]
        sigma = _robust_sigma(misses)
        good = [m <= CORNER_LIMIT * sigma for m in misses]
        rms = np.array([np.sqrt((m[g] ** 2).mean()) if g.any() else np.inf for m, g in zip(misses, good, strict=True)])
        typical = float(np.median(rms))
        bad = [n for n, g in enumerate(good) if rms[n] > VIEW_LIMIT * typical or g.sum() < max(len(g) / 2, MIN_CORNERS)]
        rejected += [
            ViewRejection(
                kept[n].pair_index, kept[n].side,
                f"the corners do not fit: RMS {np.sqrt((misses[n] ** 2).mean()):.2f} px, the median image has "
                f"{typical:.2f} px",
            )
            for n in bad
        ]  # fmt: skip
        new = [g.astype(np.float64) for n, g in enumerate(good) if n not in bad]
        same = not bad and all(np.array_equal(a, b) for a, b in zip(new, weights, strict=True))
        kept, weights = [v for n, v in enumerate(kept) if n not in bad], new
        if same:
            break
        left = len(stereo_pairs(kept))
        if left < MIN_PAIRS:
            raise BundleError(
                f"only {left} pairs are left after {len(rejected)} images that do not fit were removed: check the board's "
                "pattern, and that it does not bend while it is moved"
            )
        bundle = replace(bundle, board_SE3={p: bundle.board_SE3[p] for p in pair_indices(kept)})
        bundle = adjust(bundle, kept, weights=weights)
    corners = []
    for view, weight in zip(kept, weights, strict=True):
        misses_uv = residuals_px(bundle, view)
        for n in np.flatnonzero(weight == 0):
            (u, v), (du, dv) = view.uv_px[n].tolist(), misses_uv[n].tolist()
            corners.append(CornerRejection(view.pair_index, view.side, int(view.point_ids[n]), (u, v), (du, dv)))
    return bundle, [v.only(w > 0) for v, w in zip(kept, weights, strict=True)], tuple(rejected), tuple(corners)


def _robust_sigma(misses: Sequence[Floats]) -> float:
    """Sigma of one coordinate from the median length of the residuals (Rayleigh's distribution)."""
    return max(float(np.median(np.concatenate(misses))) / float(np.sqrt(2.0 * np.log(2.0))), 1e-9)


# --------------------------------------------------------------------------- choice


def _covariance_of(bundle: Bundle, views: Sequence[BoardView]) -> tuple[RigCovariance, float, int]:
    """Covariance, variance factor (px^2) and degrees of freedom of an adjusted bundle."""
    observations = 2 * sum(len(v.point_ids) for v in views)
    freedom = observations - bundle.rig_parameters - _shape_parameters(bundle, views) - 6 * len(pair_indices(views))
    if freedom < 1:
        raise BundleError("there are fewer corners than unknowns: take more pairs")
    factor = _sum_of_squares(bundle, views) / freedom
    return rig_covariance(reduce(bundle, views), bundle.rig_parameters, factor), factor, freedom


def _shape_parameters(bundle: Bundle, views: Sequence[BoardView]) -> int:
    """Number of shape unknowns that corners determine."""
    if not bundle.shape.size:
        return 0
    return max(3 * len(np.unique(np.concatenate([v.point_ids for v in views]))) - 7, 0)


def _sum_of_squares(bundle: Bundle, views: Sequence[BoardView]) -> float:
    return float(sum((residuals_px(bundle, v) ** 2).sum() for v in views))


def _try_model(
    bundle: Bundle, views: Sequence[BoardView], model: LensModel, shape: BoardShape, scale: float, factor: float
) -> tuple[Candidate, Bundle | None]:
    """Adjust and rate one model. scale: variance of one independent observation; factor: of one coordinate (px^2)."""
    fit = _convert(bundle, model, shape)
    parameters = fit.rig_parameters + _shape_parameters(fit, views)
    observations = 2 * sum(len(v.point_ids) for v in views)
    try:
        fit = adjust(fit, views)
        _covariance_of(fit, views)
        _check_invertible(fit)
    except BundleError as error:
        return Candidate(model, shape, parameters, None, None, str(error)), None
    squares = _sum_of_squares(fit, views)
    bic = squares / scale + parameters * float(np.log(observations * factor / scale))
    return Candidate(model, shape, parameters, float(np.sqrt(2 * squares / observations)), bic, None), fit


def _check_constancy(bundle: Bundle, views: Sequence[BoardView], factor: float) -> None:
    """Raise BundleError if earlier and later pairs have different rigs."""
    if len(pair_indices(views)) < CHANGE_PAIRS:
        return
    change = change_over_pairs(reduce(bundle, views), bundle.rig_parameters, factor)
    if change > CHANGE_LIMIT:
        raise BundleError(
            f"earlier and later pairs contradict each other (chi-square per degree of freedom {change:.0f}, at most "
            f"{CHANGE_LIMIT:g}): a camera was moved, zoomed or refocused meanwhile. Use only the pairs before or after that"
        )


def _check_invertible(bundle: Bundle) -> None:
    for side, camera in (("left", bundle.left), ("right", bundle.right)):
        lost = ~np.isfinite(undistort(camera.lens, _grid(camera, 15))).all(axis=1)
        if lost.any():
            raise BundleError(
                f"the lens of the {side} camera folds back inside the image ({100 * lost.mean():.0f} % of it): the corners "
                "do not reach far enough out for this model"
            )


def _bic_or_inf(candidate: Candidate) -> float:
    return float("inf") if candidate.bic is None else candidate.bic
