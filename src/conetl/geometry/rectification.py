"""From the rig that took the images to the rig that the images are resampled to: no lens, parallel axes, equal rows.

Rotation: x along the baseline, z the mean of both optical axes made square to it (Fusiello, Trucco & Verri 2000, with the mean
axis as in Bouguet's toolbox, so that both images are turned equally). Focal length: the largest of the rig's four, so that
no detail is lost. Image: the largest rectangle in which the raw camera saw every pixel, without black margins; both images have
the same rows.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from conetl.geometry import camera as cameras
from conetl.geometry import lens as lenses
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.arrays import Floats
from conetl.model.rig import MIN_BASELINE_M, SIDES, Camera, Rig, Side

Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in normalised coordinates of the rectified camera."""

#: Two cameras turned against each other by less than this are parallel: a tenth of a pixel at f 1000 px.
PARALLEL_RAD = 1e-4
#: ... whose baseline leaves the rows by less than this share (KITTI's own rectified pair: 0.005), ...
BASELINE_SLOPE = 0.01
#: ... and whose rows agree to this many pixels over the whole image.
ROW_TOLERANCE_PX = 0.25
#: A pinhole image stretches what is far off the axis; rectified images end this far from it.
MAX_HALF_ANGLE_RAD = np.radians(60.0)
#: ... and are at most this many times as wide and as high as the raw ones.
MAX_GROWTH = 2.0
#: Rigs whose baseline leaves the left camera's rows by more than this share are refused.
MAX_SLOPE = 0.5
_BORDER_SAMPLES = 101
#: A curved border lies this much further in between two samples of it at most (60 px apart in a 24-megapixel image).
_INSET_PX = 0.1


def is_rectified(rig: Rig) -> bool:
    """True where a rig's images can be used as they are: no lens, parallel axes along the rows, equal rows."""
    if rig.left.lens.model != "none" or rig.right.lens.model != "none":
        return False
    relative = rigs.left_SE3_right(rig)
    slope = np.hypot(relative[1, 3], relative[2, 3]) / max(abs(float(relative[0, 3])), 1e-12)
    # row difference = (fy_l - fy_r) y + ..., y up to half an image off the principal point
    stretch_px = abs(rig.left.fy_px / rig.right.fy_px - 1.0) * max(rig.left.height_px, rig.right.height_px) / 2
    return bool(
        Rotation.from_matrix(relative[:3, :3]).magnitude() <= PARALLEL_RAD
        and slope <= BASELINE_SLOPE
        and stretch_px <= ROW_TOLERANCE_PX
        and abs(rig.left.fx_px / rig.right.fx_px - 1.0) <= 1e-3
    )


def rectify(rig: Rig) -> Rig:
    """The rectified rig of a raw one, with `rectified_from` set; a rectified rig is returned unchanged.

    Raises ValueError where no image is left: the cameras look in different directions, or one stands behind the other.
    """
    if is_rectified(rig):
        return rig
    left_SE3_right = rigs.left_SE3_right(rig)
    rotations = common_rotation(left_SE3_right)
    raw = (rig.left, rig.right)
    focal = max(c for camera in raw for c in (camera.fx_px, camera.fy_px))
    boxes = [_visible_box(camera, rotation, focal) for camera, rotation in zip(raw, rotations, strict=True)]
    top, bottom = max(box[1] for box in boxes), min(box[3] for box in boxes)
    rectified = [
        _camera((box[0], top, box[2], bottom), focal, side) for box, side in zip(boxes, SIDES, strict=True)
    ]  # fmt: skip
    body = [
        se3.compose(rigs.body_SE3_camera(rig, side), se3.se3(rotation, np.zeros(3)))
        for side, rotation in zip(SIDES, rotations, strict=True)
    ]
    return Rig(
        rig_id=rig.rig_id, left=rectified[0], right=rectified[1], sigma_px=rig.sigma_px, rectified_from=rig,
        body_SE3_left=se3.to_matrix4(body[0]), body_SE3_right=se3.to_matrix4(body[1]),
    )  # fmt: skip


def check_stereo_baseline(left_SE3_right: ArrayLike) -> None:
    """Raise ValueError unless the right camera is to the right of the left one, roughly along its rows."""
    x, y, z = (float(c) for c in np.asarray(left_SE3_right, dtype=np.float64)[:3, 3])
    if not x > MIN_BASELINE_M:
        cause = "are left and right swapped?" if x <= 0 else "are lengths in another unit (conetl rig convert --unit)?"
        raise ValueError(
            f"the right camera must sit to the right of the left one, found {x:.4f} m along the image rows: {cause}"
        )
    if np.hypot(y, z) > MAX_SLOPE * x:
        raise ValueError(f"the baseline ({x:.3f}, {y:.3f}, {z:.3f}) m does not follow the image rows")


def common_rotation(left_SE3_right: ArrayLike) -> tuple[Floats, Floats]:
    """(3, 3) rotations left_R_rectified and right_R_rectified from the rig's relative pose (4, 4).

    Raises ValueError where the baseline runs along the viewing direction or the axes oppose each other.
    """
    relative = np.asarray(left_SE3_right, dtype=np.float64)
    x = relative[:3, 3] / np.linalg.norm(relative[:3, 3])
    mean_axis = np.array([0.0, 0.0, 1.0]) + relative[:3, 2]
    z = mean_axis - (mean_axis @ x) * x
    if np.linalg.norm(z) < 0.5:
        raise ValueError("the cameras look along their baseline or in different directions: no common image plane")
    z /= np.linalg.norm(z)
    left_R_rect = np.column_stack([x, np.cross(z, x), z])
    return left_R_rect, relative[:3, :3].T @ left_R_rect


def stored_camera(rig: Rig, side: Side) -> Camera:
    """The camera of the images as they are stored: the raw one where a rig was rectified, else the rig's own."""
    return rigs.camera_of(rig.rectified_from or rig, side)


def raw_from_rectified(rig: Rig, side: Side, uv_px: ArrayLike) -> Floats:
    """Image points (..., 2) of the stored image for image points (..., 2) of the rectified one; NaN where it saw nothing.

    A rig without `rectified_from` gives the points back.
    """
    uv = np.asarray(uv_px, dtype=np.float64)
    if rig.rectified_from is None:
        return uv.copy()
    rays = cameras.rays(rigs.camera_of(rig, side), uv)
    return _project_to_raw(stored_camera(rig, side), rigs.stored_R_camera(rig, side), rays)


def rectified_from_raw(rig: Rig, side: Side, uv_px: ArrayLike) -> Floats:
    """Inverse of `raw_from_rectified`: (..., 2) in the rectified image for points of the stored one; NaN where there is none."""
    uv = np.asarray(uv_px, dtype=np.float64)
    if rig.rectified_from is None:
        return uv.copy()
    rays = cameras.rays(stored_camera(rig, side), uv) @ rigs.stored_R_camera(rig, side)
    ahead = np.where(rays[..., 2:] > 1e-9, rays, np.nan)
    camera = rigs.camera_of(rig, side)
    scale, shift = np.array([camera.fx_px, camera.fy_px]), np.array([camera.cx_px, camera.cy_px])
    return np.asarray(ahead[..., :2] / ahead[..., 2:] * scale + shift)


def _project_to_raw(raw: Camera, raw_R_rect: Floats, rays: Floats) -> Floats:
    """Image points (..., 2) of the raw camera for directions (..., 3) of the rectified one; NaN outside the raw image."""
    d = rays @ raw_R_rect.T
    ahead = d[..., 2:] > 1e-6
    xy = d[..., :2] / np.where(ahead, d[..., 2:], 1.0)
    inside = ahead & (np.hypot(xy[..., 0], xy[..., 1]) < lenses.field_radius(raw.lens))[..., None]
    xy = np.where(inside, xy, 0.0)
    uv = lenses.distort(raw.lens, xy) * [raw.fx_px, raw.fy_px] + [raw.cx_px, raw.cy_px]
    slack = 1e-6  # a border sample may be off by rounding
    last = np.array([raw.width_px - 1.0, raw.height_px - 1.0])
    seen = inside & ((uv >= -slack) & (uv <= last + slack)).all(axis=-1, keepdims=True)
    return np.where(seen, np.clip(uv, 0.0, last), np.nan)


def _visible_box(raw: Camera, raw_R_rect: Floats, focal_px: float) -> Box:
    """Normalised rectangle of the rectified camera that lies wholly in the raw image.

    Its sides start at the innermost point of each border of the raw image and shrink until every sample of the rectangle's
    outline is visible.
    """
    w, h = raw.width_px - 1.0, raw.height_px - 1.0
    t = np.linspace(0.0, 1.0, _BORDER_SAMPLES)
    left, right, top, bottom = (
        np.column_stack(side)
        for side in ((0 * t, t * h), (w + 0 * t, t * h), (t * w, 0 * t), (t * w, h + 0 * t))
    )  # fmt: skip
    reach = np.tan(MAX_HALF_ANGLE_RAD)
    cap_x = min(reach, MAX_GROWTH * raw.width_px / 2 / focal_px)
    cap_y = min(reach, MAX_GROWTH * raw.height_px / 2 / focal_px)
    x0 = max(-cap_x, _innermost(raw, raw_R_rect, left, 0, np.nanmax, -cap_x))
    x1 = min(cap_x, _innermost(raw, raw_R_rect, right, 0, np.nanmin, cap_x))
    y0 = max(-cap_y, _innermost(raw, raw_R_rect, top, 1, np.nanmax, -cap_y))
    y1 = min(cap_y, _innermost(raw, raw_R_rect, bottom, 1, np.nanmin, cap_y))
    if not (x0 < x1 and y0 < y1):
        raise ValueError("nothing is left of an image after rectification: check the rotation between the cameras")
    middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
    half = np.array([(x1 - x0) / 2, (y1 - y0) / 2])
    one, run = np.ones_like(t), 2 * t - 1
    outline = np.concatenate([np.column_stack(side) for side in ((run, -one), (run, one), (-one, run), (one, run))])

    def all_seen(share: float) -> bool:
        xy = middle + share * half * outline
        return bool(np.isfinite(_project_to_raw(raw, raw_R_rect, np.column_stack([xy, np.ones(len(xy))]))).all())

    low, high = 0.0, 1.0
    if not all_seen(1.0):
        for _ in range(30):
            share = (low + high) / 2
            low, high = (share, high) if all_seen(share) else (low, share)
        if low < 0.1:
            raise ValueError("hardly anything is left of an image after rectification: check lens and rotation")
        half = low * half
    half -= _INSET_PX / focal_px
    return (
        float(middle[0] - half[0]), float(middle[1] - half[1]), float(middle[0] + half[0]), float(middle[1] + half[1])
    )  # fmt: skip


def _innermost(
    raw: Camera, raw_R_rect: Floats, uv: Floats, axis: int, pick: Callable[[Floats], float], otherwise: float
) -> float:
    """Innermost x or y in the rectified camera of a border (n, 2) of the raw image; `otherwise` if no ray passes through it.

    A fisheye's border may lie beyond 90 degrees: then it does not limit the rectified image.
    """
    d = cameras.rays(raw, uv) @ raw_R_rect
    good = np.isfinite(d).all(axis=1) & (d[:, 2] > 1e-6)
    return float(pick(d[good, axis] / d[good, 2])) if good.any() else otherwise


def _camera(box: Box, focal_px: float, side: Side) -> Camera:
    """Camera whose pixel centres fill a normalised rectangle."""
    width, height = ((box[i + 2] - box[i]) * focal_px for i in (0, 1))
    if width < 16 or height < 16:
        raise ValueError(f"the {side} image would be {width:.0f} x {height:.0f} pixels after rectification")
    return Camera(
        width_px=int(width) + 1, height_px=int(height) + 1, fx_px=focal_px, fy_px=focal_px,
        cx_px=-box[0] * focal_px, cy_px=-box[1] * focal_px,
    )  # fmt: skip
