"""Tracks of lane markings from made-up points along a bend: course, pattern, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from conetl.geometry import pose as se3
from conetl.geometry.motion.rolling_shutter import as_exposed, camera_rates, right_rates, with_shutters
from conetl.geometry.packing import cov_matrices, vec3
from conetl.geometry.rig import map_SE3_left
from conetl.model.drive import Drive, FramePair, Pose
from conetl.model.markings import MarkingTrack
from conetl.model.params import MarkingParams
from conetl.model.rig import Camera, Rig, Shutter
from conetl.perception.markings.points import MarkingPoints, PointColumns
from conetl.tracking.markings.located import camera_points, locate_points
from conetl.tracking.markings.tracks import fuse_markings
from tests.synthetic.world import drive_of

Floats = NDArray[np.float64]
CAMERA = Camera(width_px=1200, height_px=400, fx_px=700.0, fy_px=700.0, cx_px=600.0, cy_px=150.0)
_LEFT = se3.se3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [0.0, 0.0, 1.6])
RIG = Rig(
    rig_id="test", left=CAMERA, right=CAMERA, body_SE3_left=se3.to_matrix4(_LEFT),
    body_SE3_right=se3.to_matrix4(se3.compose(_LEFT, se3.se3(np.eye(3), [0.54, 0.0, 0.0]))),
)  # fmt: skip
RADIUS_M, STEP_M, FRAMES = 80.0, 1.0, 60
CENTRE = np.array([458_000.0, 5_428_000.0])
HEIGHT_M, DEPTHS_M = 115.0, np.arange(4.0, 17.0, 0.2)
#: Where there is paint, by the length along the bend.
Paint = Callable[[Floats], NDArray[np.bool_]]


def _at(along_m: Floats, offset_m: Floats) -> Floats:
    """(N, 2) on a bend to the left."""
    angle = along_m / RADIUS_M
    return np.asarray(CENTRE + (RADIUS_M - offset_m)[..., None] * np.stack([np.sin(angle), -np.cos(angle)], axis=-1))


def _swung(along_m: Floats) -> Floats:
    """Share of a smooth change of lanes between 15 and 55 m."""
    share = np.clip((along_m - 15.0) / 40.0, 0.0, 1.0)
    return np.asarray(share**2 * (3 - 2 * share))


def _drive() -> Drive:
    """Along the bend, changing lanes by 1 m: markings drift across the path."""
    pairs = []
    for k in range(FRAMES):
        along = np.array([k * STEP_M, k * STEP_M + 0.1])
        places = _at(along, 1 / (1 + np.exp(-(along - 30) / 5)))
        heading = np.arctan2(*(places[1] - places[0])[::-1])
        place = np.array([*places[0], HEIGHT_M])
        pose = Pose(
            map_R_body=se3.to_matrix3(se3.rotation_from_rpy(0.0, 0.0, heading)), map_t_body_m=vec3(place),
            sigma_enu_m=(0.02, 0.02, 0.03), sigma_rpy_rad=(0.0003, 0.0003, 0.0003),
        )  # fmt: skip
        pairs.append(FramePair(frame_index=k, left_path="l", right_path="r", captured_at_ns=1 + k * 10**8, pose=pose))
    return drive_of(pairs, RIG)


DRIVE = _drive()


def _points(
    markings: dict[float, Paint],
    *,
    above_m: float = 0.0,
    share: float = 0.95,
    seed: int = 1,
    depth_px: float = 0.2,
    swing_m: float = 0.0,
) -> list[MarkingPoints]:
    """What each frame pair shows of markings at these offsets from the middle of the road, 1 m to its left, that swing to the
    left by swing_m."""
    rng = np.random.default_rng(seed)
    fine = np.arange(-5.0, FRAMES * STEP_M + 25.0, 0.02)
    found = []
    rows = CAMERA.cy_px + CAMERA.fy_px * 1.6 / DEPTHS_M
    for pair in DRIVE.frame_pairs:
        pose, values = map_SE3_left(pair.pose, RIG), []
        for offset, paint in markings.items():
            xyz = np.column_stack([_at(fine, offset + swing_m * _swung(fine)), np.full(len(fine), HEIGHT_M)])
            seen = (xyz - pose[:3, 3]) @ pose[:3, :3]
            ahead = (seen[:, 2] > 3.5) & (seen[:, 2] < 18.0) & (np.abs(fine - pair.frame_index * STEP_M) < 25)
            order = np.argsort(seen[ahead, 2])
            side, along = (np.interp(DEPTHS_M, seen[ahead, 2][order], x[ahead][order]) for x in (seen[:, 0], fine))
            disparity = CAMERA.fx_px * RIG.baseline_m / DEPTHS_M
            u = CAMERA.cx_px + CAMERA.fx_px * side / DEPTHS_M
            shown = (u > 0) & (u < 1199) & (u - disparity > 0) & paint(along) & (rng.random(len(u)) < share)
            noise = rng.normal(0, 1, (4, len(u)))
            values.append(np.column_stack([
                u + 0.2 * noise[0], rows, disparity + depth_px * noise[1], 0.12 + 0.01 * noise[2], np.full(len(u), 60.0),
                np.zeros(len(u)), np.zeros(len(u)), above_m + 0.02 * noise[3], np.zeros(len(u)),
                disparity + 0.05 * noise[1], np.arange(len(u)), np.full(len(u), 0.8),
            ])[shown])  # fmt: skip
        assert values[0].shape[1] == len(PointColumns._fields)
        found.append(
            MarkingPoints(
                frame_index=pair.frame_index, points=np.concatenate(values), rows=np.stack([rows, DEPTHS_M], axis=1)
            )
        )
    return found


def fused(markings: dict[float, Paint], **how: Any) -> list[MarkingTrack]:
    return fuse_markings(
        _points(markings, **how), DRIVE, MarkingParams(), lambda frames: np.eye(6 * len(frames)) * 1e-8
    )


def everywhere(along_m: Floats) -> NDArray[np.bool_]:
    return np.full(along_m.shape, True)


def dashes(length_m: float, period_m: float) -> Paint:
    return lambda along_m: along_m % period_m < length_m


def _across(track: MarkingTrack, offset_m: float) -> Floats:
    """Errors of the vertices, to the outside of the bend."""
    xy = np.array(track.marking.vertices_m)[:, :2]
    return np.asarray(np.linalg.norm(xy - CENTRE, axis=1) - (RADIUS_M - offset_m))


@pytest.mark.parametrize(("dash_m", "period_m"), [(3.0, 6.0), (3.0, 9.0), (6.0, 15.0), (1.0, 2.0)])
def test_solid_and_dashed_lines_of_a_bend_are_found_where_they_are(dash_m: float, period_m: float) -> None:
    tracks = sorted(fused({-1.5: everywhere, 2.5: dashes(dash_m, period_m)}), key=lambda t: _across(t, 0)[0])
    assert [track.marking.pattern for track in tracks] == ["dashed", "solid"]
    for track, offset in zip(tracks, (2.5, -1.5), strict=True):
        errors = _across(track, offset)
        assert np.median(np.abs(errors)) < 0.02
        assert np.abs(errors).max() < 0.1
        assert np.abs(np.array(track.marking.vertices_m)[:, 2] - HEIGHT_M).max() < 0.03
        assert track.marking.colour == "white"
        assert track.existence_probability > 0.9
        own = np.sqrt(np.trace(cov_matrices(track.relative_cov_m2)[:, :2, :2], axis1=1, axis2=2))
        assert 0.2 < np.median(np.abs(errors) / own) < 1.5
    assert tracks[0].marking.dash_m == pytest.approx(dash_m, abs=0.2)
    assert tracks[0].marking.gap_m == pytest.approx(period_m - dash_m, abs=0.2)
    steps = np.linalg.norm(np.diff(np.array(tracks[1].marking.vertices_m)[:, :2], axis=0), axis=1)
    assert 2.0 < steps.min() <= steps.max() < 3.0


def _across_cov(track: MarkingTrack, unit: Floats) -> Floats:
    """(K, K) of a track's vertices along unit vectors (K, 2), from the images alone."""
    (joint,) = track.image_covs()
    return np.asarray(np.einsum("ki,kilj,lj->kl", unit, joint.reshape(2 * (len(unit), 3))[:, :2, :, :2], unit))


def _across_swung(track: MarkingTrack, offset_m: float, swing_m: float) -> tuple[Floats, Floats, Floats]:
    """Errors of the vertices to the left of a line that swings, their stated sigmas, and how far along the bend they are."""
    outwards = np.array(track.marking.vertices_m)[:, :2] - CENTRE
    radius_m = np.linalg.norm(outwards, axis=1)
    along_m = np.arctan2(outwards[:, 0], -outwards[:, 1]) * RADIUS_M
    unit = outwards / radius_m[:, None]
    sigma = np.sqrt(np.diagonal(_across_cov(track, unit)))
    slope = np.gradient(swing_m * _swung(np.array([along_m - 0.1, along_m + 0.1])), 0.2, axis=0)[0]
    errors = (RADIUS_M - radius_m - offset_m - swing_m * _swung(along_m)) / np.hypot(1, slope)
    return errors, sigma, along_m


def test_vertices_do_not_zigzag_more_than_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit with a penalty has smooth errors, most of all in gaps: independent vertices with the same sigmas would zigzag three
    times as much. Points have nothing but noise; pairs of seeds, so that what they have in common cancels."""
    for name, value in {"_FRAME_SIGMA_PX": 0.0, "_COMMON_SIGMA_PX": 0.0, "_NOISE_SHARE": 1.0}.items():
        monkeypatch.setattr(f"conetl.tracking.markings.tracks.{name}", value)
    actual_m2, stated_m2, independent_m2 = [], [], []
    tracks = [fused({-1.5: dashes(3.0, 12.0)}, seed=seed, share=1.0)[0] for seed in range(10)]
    for pair in zip(tracks[::2], tracks[1::2], strict=True):
        outwards = [np.array(track.marking.vertices_m)[:, :2] - CENTRE for track in pair]
        cov = sum(
            _across_cov(track, xy / np.linalg.norm(xy, axis=1)[:, None])
            for track, xy in zip(pair, outwards, strict=True)
        )
        zigzag = np.diff(np.eye(len(cov)), n=2, axis=0)
        actual_m2.append((zigzag @ (_across(pair[0], -1.5) - _across(pair[1], -1.5))) ** 2)
        stated_m2.append(np.diagonal(zigzag @ cov @ zigzag.T))
        independent_m2.append(zigzag**2 @ np.diagonal(cov))
    assert 0.6 < np.mean(actual_m2) / np.mean(stated_m2) < 1.6
    assert np.mean(independent_m2) > 9 * np.mean(stated_m2)


def test_vertices_of_a_curve_lie_on_it_and_not_inside_of_it() -> None:
    """A polyline fitted to the points of a curve would have its vertices a twelfth of the bend inside, here 4 mm."""
    (track,) = fused({-3.5: everywhere}, swing_m=5.0, depth_px=0.02)
    errors, _, along = _across_swung(track, -3.5, 5.0)
    left, right = (along > 15) & (along < 30), (along > 40) & (along < 55)
    assert abs(np.mean(errors[left]) - np.mean(errors[right])) < 0.003


def test_the_end_of_a_curve_bends_as_the_curve_before_it() -> None:
    """Few points show the last vertex, which the fit alone would put 10 mm aside, straight on."""
    (track,) = fused({-3.5: lambda along: along < 50}, swing_m=5.0)
    errors, sigma, along = _across_swung(track, -3.5, 5.0)
    assert along[-1] > 48
    assert abs(errors[-1]) < 0.007
    assert sigma[-1] > 0.003


def test_a_line_that_crosses_the_path_has_the_stated_errors_ahead_and_aside() -> None:
    """Errors of disparities move points along their rays: those beside the camera across the line, those ahead along it."""
    ahead, aside = [], []
    for seed in range(6):
        track = fused({-2.5: everywhere}, swing_m=5.0, seed=seed, depth_px=1.0)[0]
        errors, sigma, along = _across_swung(track, -2.5, 5.0)
        ratio = np.square(errors / sigma)
        ahead += ratio[(along > 28) & (along < 40)].tolist()
        aside += ratio[(along > 0) & (along < 20)].tolist()
    assert 0.55 < np.mean(ahead) < 1.8
    assert 0.55 < np.mean(aside) < 1.8


def test_a_worn_line_is_solid_and_a_long_break_ends_it() -> None:
    worn = fused({-1.5: lambda along: ~((along > 20) & (along < 22)) & ~((along > 30) & (along < 33))})
    assert [track.marking.pattern for track in worn] == ["solid"]
    broken = fused({-1.5: lambda along: (along < 22) | (along > 34)})
    assert [track.marking.pattern for track in broken] == ["solid", "solid"]


def test_a_solid_line_that_goes_on_as_dashes_is_two_markings() -> None:
    tracks = fused({-1.5: lambda along: (along < 25) | (along % 6 < 3)})
    assert [track.marking.pattern for track in tracks] == ["solid", "dashed"]


def test_two_dashes_after_a_solid_line_leave_it_on_the_map() -> None:
    tracks = fused({-1.5: lambda along: (along < 25) | ((along > 28) & (along < 31)) | ((along > 40) & (along < 43))})
    assert [track.marking.pattern for track in tracks] == ["solid", "dashed"]
    assert tracks[1].marking.gap_m == pytest.approx(9.0, abs=0.2)


def test_dashes_have_their_length_although_the_ends_of_some_are_bare() -> None:
    bare = {1: (1.0, 0.0), 2: (0.0, 1.2), 3: (0.9, 0.0), 4: (0.0, 0.8)}

    def paint(along_m: Floats) -> NDArray[np.bool_]:
        before, behind = np.array([bare.get(k, (0.0, 0.0)) for k in (along_m // 12).astype(int)]).T
        return np.asarray((along_m % 12 > before) & (along_m % 12 < 6.0 - behind))

    (track,) = fused({2.5: paint})
    assert track.marking.dash_m == pytest.approx(6.0, abs=0.5)
    assert track.marking.gap_m == pytest.approx(6.0, abs=0.5)


def test_worn_dashes_are_found_where_so_worn_a_solid_line_is_doubtful() -> None:
    (track,) = fused({-1.5: everywhere, 2.5: dashes(6.0, 15.0)}, share=0.25)
    assert track.marking.pattern == "dashed"
    assert track.marking.dash_m == pytest.approx(6.0, abs=0.5)


def test_kerbs_and_what_is_seldom_seen_are_no_markings() -> None:
    assert fused({-1.5: everywhere}, above_m=0.1) == []
    assert fused({-1.5: everywhere}, share=0.1) == []
    assert fused({-1.5: lambda along: (along > 20) & (along < 22)}) == []


def test_lines_end_on_their_course_although_depths_of_far_points_are_uncertain() -> None:
    """The last vertex of a bend, seen from afar alone: neither too low, as points that look too far away are, nor straight on."""
    last = []
    for seed in range(6):
        (track,) = fused({-1.5: everywhere}, seed=seed, depth_px=0.6)
        last.append([_across(track, -1.5)[-1], track.marking.vertices_m[-1][2] - HEIGHT_M])
    assert np.mean(last, axis=0) == pytest.approx([0.0, 0.0], abs=0.012)


@pytest.mark.parametrize(("left_ms", "right_ms"), [(20.0, 20.0), (20.0, 24.0)])
def test_points_of_a_rolling_shutter_are_where_those_of_a_global_one_are(left_ms: float, right_ms: float) -> None:
    """At 10 m/s: the image points are moved to where each row saw them, and come back."""
    left, right = (Shutter(readout_ms=ms, stamp_row="first") for ms in (left_ms, right_ms))
    rig = with_shutters(RIG, left, right)
    drive = DRIVE.model_copy(update={"rig": rig})
    rates = camera_rates(DRIVE.frame_pairs, RIG)
    found, rolled = _points({1.0: everywhere}, share=1.0), []
    for one in found:
        own = one.columns()
        at_road, at_stamp = (camera_points(own, px, RIG) for px in (own.road_px, own.disparity_px))
        rate = rates[one.frame_index]
        shift = np.array([RIG.baseline_m, 0.0, 0.0])
        seen_left = as_exposed(at_stamp, CAMERA, rig, "left", rate)
        seen_right = as_exposed(at_stamp - shift, CAMERA, rig, "right", right_rates(rig, rate[None])[0])
        seen_road = as_exposed(at_road, CAMERA, rig, "left", rate)
        u, v = (700.0 * seen_left[:, k] / seen_left[:, 2] + c for k, c in ((0, 600.0), (1, 150.0)))
        u_right = 700.0 * seen_right[:, 0] / seen_right[:, 2] + 600.0
        moved = own._replace(u_px=u, v_px=v, disparity_px=u - u_right, road_px=700.0 * 0.54 / seen_road[:, 2])
        rolled.append(one.model_copy(update={"points": np.stack(moved, axis=1).astype("<f8").tobytes()}))
    still = locate_points(found, DRIVE, 17.0)
    for points, close_m in ((rolled, 0.003 if left_ms == right_ms else 0.02), (found, 0.5)):
        located = locate_points(points, drive, 17.0)
        assert still is not None and located is not None
        off_m = np.abs(located.xyz_m - still.xyz_m).max()
        assert off_m < close_m and (points is rolled or off_m > 0.1)
