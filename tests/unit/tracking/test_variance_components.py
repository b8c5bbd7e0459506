"""Variance factors of observations: drawn errors are estimated, whatever the stated ones; gross errors are found one by one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from conetl.geometry import pose as se3
from conetl.model.arrays import Floats
from conetl.model.drive import Drive, FramePair, StereoMatch, Track
from conetl.model.feature_classes import CONE
from conetl.model.params import TrajectoryParams
from conetl.model.rig import SIDES
from conetl.tracking.error_propagation import PoseCov, pose_cov
from conetl.tracking.matching.covariance import SHARED_DISPARITY_PX, with_shared_part
from conetl.tracking.trajectory import refine_trajectory
from conetl.tracking.variance_components import (
    VarianceFactors,
    estimate_variance_factors,
    with_contradictions,
    with_variance_factors,
)
from tests import records
from tests.synthetic.odometry import log_of, motions_of
from tests.synthetic.world import ORIGIN_M, camera_pose, make_path, make_rig

RIG, PATH = make_rig(), make_path(24)
FEET_M = np.array([[x, y, 0.0] for x in (12.0, 18.0, 24.0, 30.0) for y in (-3.5, 3.0)]) + ORIGIN_M
OUTLINE_PX = 0.3
DRUM = {"category": "drum", "foot_px": None}


def drawn(
    rng: np.random.Generator,
    sizes: tuple[float, float, float],
    *,
    cones: int = 8,
    wild: float = 0.0,
    speeds_ms: Floats | None = None,
) -> tuple[list[StereoMatch], list[Track]]:
    """Observations with errors of `sizes` times the stated ones in columns, rows and disparities, and tracks centimetres off.

    wild: share of the observations with an error of 15 px. All observations of a cone share an error of two sigmas.
    speeds_ms (N, 3): of cones that move.
    """
    matches, tracks = [], []
    for number, foot in enumerate(FEET_M[:cones]):
        members = []
        for pair in PATH:
            uv = {}
            seconds = (pair.captured_at_ns - PATH[len(PATH) // 2].captured_at_ns) * 1e-9
            moved = foot if speeds_ms is None else foot + seconds * speeds_ms[number]
            for side, camera in (("left", RIG.left), ("right", RIG.right)):
                local = (moved - camera_pose(pair, RIG, side)[:3, 3]) @ camera_pose(pair, RIG, side)[:3, :3]
                if local[2] > 3.0:
                    scale = np.array([camera.fx_px, camera.fy_px]) / local[2]
                    uv[side] = np.array([camera.cx_px, camera.cy_px]) + scale * local[:2] + 2 * OUTLINE_PX
            if len(uv) < 2:
                continue
            # All observations state different sigmas.
            pointing, across, of_disparity = np.array([0.4, 0.7, 0.08]) * rng.uniform(0.6, 1.6)
            both = rng.normal(0, sizes[0] * pointing) + 15.0 * (rng.random() < wild)
            apart = rng.normal(0, sizes[2] * of_disparity) / 2
            uv["left"] += [both + apart, rng.normal(0, sizes[1] * across)]
            uv["right"] += [both - apart, rng.normal(0, sizes[1] * across)]
            at = {"frame": pair.frame_index, "index": number, "foot_px": (610.0, 210.0)}
            boxes = {side: records.box(600, 180, 20, 30, side=side, **at) for side in SIDES}
            left, right = ((float(uv[side][0]), float(uv[side][1])) for side in ("left", "right"))
            matches.append(
                records.matches(1)[0].model_copy(
                    update={
                        "frame_index": pair.frame_index, "match_index": number,
                        **boxes,
                        "foot_left_uv_px": left, "foot_right_uv_px": right,
                        "sigma_u_px": with_shared_part(float(np.hypot(of_disparity, SHARED_DISPARITY_PX))) / 2**0.5,
                        "sigma_v_px": float(across), "sigma_pointing_px": float(pointing), "sigma_outline_px": OUTLINE_PX,
                    }
                )
            )  # fmt: skip
            members.append((pair.frame_index, number))
        x, y, z = (foot + rng.normal(0, 0.05, 3)).tolist()
        tracks.append(
            records.track(number).model_copy(
                update={"xyz_m": (x, y, z), "members": tuple(members), "observation_count": len(members)}
            )
        )
    return matches, tracks


def without_errors(frames: Sequence[int]) -> Floats:
    """Covariance of poses that are exact."""
    return np.zeros((6 * len(frames), 6 * len(frames)))


def drive_of(pairs: list[FramePair]) -> Drive:
    return Drive.model_construct(frame_pairs=tuple(pairs), rig=RIG)


def found(
    matches: list[StereoMatch],
    tracks: list[Track],
    pairs: list[FramePair] = PATH,
    pose_cov: PoseCov = without_errors,
) -> VarianceFactors:
    return by_class(matches, tracks, pairs, pose_cov)[CONE]


def by_class(
    matches: list[StereoMatch],
    tracks: list[Track],
    pairs: list[FramePair] = PATH,
    pose_cov: PoseCov = without_errors,
) -> dict[str, VarianceFactors]:
    return estimate_variance_factors(drive_of(pairs), matches, tracks, pose_cov)


@pytest.mark.parametrize("sizes", [(1.0, 1.0, 1.0), (1.5, 0.7, 1.3), (0.7, 1.6, 0.6)])
def test_drawn_factors_are_estimated(sizes: tuple[float, float, float]) -> None:
    """Without bias, each group alone, with unknown positions and shared errors."""
    rng = np.random.default_rng(5)
    factors = np.array([found(*drawn(rng, sizes)) for _ in range(12)])
    count = len(drawn(rng, sizes)[0])
    assert count > 100
    # The stated variances count as 16 residuals.
    expected = (count * np.square(sizes) + 16) / (count + 16)
    assert factors.mean(axis=0) == pytest.approx(expected, rel=0.1)
    assert (factors.std(axis=0) / expected < 1.5 * (2 / count) ** 0.5).all()


def test_drifting_poses_are_no_scatter_of_the_images() -> None:
    """A refined log of an RTK receiver: with the covariance of its poses the drawn factors are found, without it larger ones."""
    params, rng = TrajectoryParams(), np.random.default_rng(6)
    truth = np.stack([se3.map_SE3_body(pair.pose) for pair in PATH])
    knowing, naive = [], []
    for _ in range(6):
        log = log_of(truth, rng, 0.06, 0.001, params)
        refined = refine_trajectory(log, RIG, motions_of(truth, RIG, rng, params), params)
        matches, tracks = drawn(rng, (1.0, 1.0, 1.0))
        moved = list(refined.frame_pairs)
        knowing.append(found(matches, tracks, moved, pose_cov(refined, params)))
        naive.append(found(matches, tracks, moved))
    assert np.mean(knowing, axis=0) == pytest.approx(1.0, abs=0.15)
    assert (np.mean(naive, axis=0)[:2] > 1.3).all()


def test_few_observations_change_little() -> None:
    """The stated variances prevail over two or three observations, and factors are limited."""
    matches, tracks = drawn(np.random.default_rng(1), (1.5, 1.5, 1.5), cones=1)
    few = tracks[0].model_copy(update={"members": tracks[0].members[:3]})
    assert by_class(matches, []) == {}
    assert found([m.model_copy(update={"refined": False}) for m in matches], tracks) == (1.0, 1.0, 1.0)
    assert np.array(found(matches, [few])) == pytest.approx(1.0, abs=0.5)
    assert found(*drawn(np.random.default_rng(2), (9.0, 9.0, 9.0))) == (4.0, 4.0, 4.0)
    assert found(*drawn(np.random.default_rng(3), (0.05, 0.05, 0.05))) == pytest.approx((0.25, 0.25, 0.25), rel=0.01)


def test_each_class_has_its_own_factors() -> None:
    """Cones with wild columns and disparities beside drums with precise ones, whose boxes have no feet."""
    rng, factors = np.random.default_rng(8), []
    for _ in range(6):
        matches, tracks = drawn(rng, (1.5, 0.7, 1.3))
        others, drums = drawn(rng, (0.7, 1.5, 0.7))
        for n, match in enumerate(others):
            boxes = {side: getattr(match, side).model_copy(update=DRUM) for side in ("left", "right")}
            others[n] = match.model_copy(update={**boxes, "match_index": match.match_index + 100})
        for n, track in enumerate(drums):
            members = tuple((frame, number + 100) for frame, number in track.members)
            drums[n] = track.model_copy(update={"category": "drum", "members": members})
        of_classes = by_class([*matches, *others], [*tracks, *drums])
        factors.append([of_classes[CONE], of_classes["drum"]])
    expected = np.array([[2.1, 0.55, 1.6], [0.55, 2.1, 0.55]])
    assert np.mean(factors, axis=0) == pytest.approx(expected, rel=0.15)


def test_outliers_are_down_weighted() -> None:
    """One in thirty has an error of 15 px, forty sigmas."""
    rng = np.random.default_rng(11)
    factors = np.mean([found(*drawn(rng, (1.0, 1.0, 1.0), wild=0.03)) for _ in range(6)], axis=0)
    assert (factors > 0.8).all()
    assert (factors < 1.5).all()


def test_only_observations_that_were_used_change() -> None:
    """Without the part of the disparity common to all observations of a cone."""
    matches, tracks = drawn(np.random.default_rng(4), (1.0, 1.0, 1.0), cones=2)
    rough = matches[0].model_copy(update={"refined": False})
    box_alone = matches[1].model_copy(update={"sigma_outline_px": 0.0})
    matches[:2] = [rough, box_alone]
    factors = VarianceFactors(columns=4.0, rows=0.25, disparity=0.25)
    changed = with_variance_factors(matches, {CONE: factors})
    assert with_variance_factors(matches, {"drum": factors}) == matches
    assert changed[:2] == [rough, box_alone]
    for old, new in zip(matches[2:], changed[2:], strict=True):
        assert new.sigma_pointing_px == pytest.approx(2 * old.sigma_pointing_px)
        assert new.sigma_v_px == pytest.approx(old.sigma_v_px / 2)
        assert 2 * new.sigma_u_px**2 - SHARED_DISPARITY_PX**2 == pytest.approx(
            (2 * old.sigma_u_px**2 - SHARED_DISPARITY_PX**2) / 4
        )
        assert new.foot_left_uv_px == old.foot_left_uv_px
    # Unused ones do not affect the factors.
    moved = rough.model_copy(update={"foot_left_uv_px": (0.0, 0.0)})
    assert found([moved, *matches[1:]], tracks) == found(matches, tracks)


def compared(matches: list[StereoMatch], tracks: list[Track]) -> list[StereoMatch]:
    return with_contradictions(drive_of(PATH), matches, tracks, without_errors)


def _moved(match: StereoMatch, columns_px: float, rows_px: float, disparity_px: float) -> StereoMatch:
    """The match of a box with these errors."""
    feet = {"left": match.foot_left_uv_px, "right": match.foot_right_uv_px}
    apart = {"left": disparity_px / 2, "right": -disparity_px / 2}
    return match.model_copy(
        update={f"foot_{side}_uv_px": (u + columns_px + apart[side], v + rows_px) for side, (u, v) in feet.items()}
    )


@pytest.mark.parametrize("at", [0, 7, -1])
@pytest.mark.parametrize("refined", [True, False])
def test_the_sigma_of_a_gross_error_becomes_its_size(at: int, refined: bool) -> None:
    """Also that of the nearest observation, which alone weighs more than most others, and of one from boxes alone."""
    matches, tracks = drawn(np.random.default_rng(21), (1.0, 1.0, 1.0), cones=1)
    assert compared(matches, tracks) == matches
    number = range(len(matches))[at]
    wrong = matches[number].model_copy(update={"refined": refined})
    spoiled = [*matches[:number], _moved(wrong, 9.0, -12.0, 2.5), *matches[number + 1 :]]
    found = compared(spoiled, tracks)
    assert [m for k, m in enumerate(found) if k != number] == [m for k, m in enumerate(matches) if k != number]
    assert found[number].sigma_pointing_px == pytest.approx(9.0, rel=0.3)
    assert found[number].sigma_v_px == pytest.approx(2**0.5 * 12.0, rel=0.3)
    assert 2**0.5 * found[number].sigma_u_px == pytest.approx(2.5, rel=0.3)
    assert found[number].model_copy(update=_sigmas(wrong)) == spoiled[number]


def _sigmas(match: StereoMatch) -> dict[str, float]:
    return {name: getattr(match, name) for name in ("sigma_pointing_px", "sigma_v_px", "sigma_u_px")}


def test_several_gross_errors_do_not_hide_each_other() -> None:
    matches, tracks = drawn(np.random.default_rng(22), (1.0, 1.0, 1.0), cones=1)
    wrong = {0: 6.0, 1: 7.0, 2: 8.0, 3: 9.0}
    spoiled = [_moved(m, 0.0, wrong.get(k, 0.0), 0.0) for k, m in enumerate(matches)]
    found = compared(spoiled, tracks)
    assert [k for k, (a, b) in enumerate(zip(found, spoiled, strict=True)) if a != b] == list(wrong)
    assert [found[k].sigma_v_px / 2**0.5 for k in wrong] == pytest.approx(list(wrong.values()), rel=0.3)


def test_normal_errors_are_rarely_gross_ones_and_no_sigma_shrinks() -> None:
    rng = np.random.default_rng(23)
    before, after = [], []
    for _ in range(6):
        matches, tracks = drawn(rng, (1.0, 1.0, 1.0))
        before += matches
        after += compared(matches, tracks)
    assert sum(a != b for a, b in zip(after, before, strict=True)) <= 0.01 * len(before)
    for name in ("sigma_pointing_px", "sigma_v_px", "sigma_u_px"):
        assert all(getattr(a, name) >= getattr(b, name) for a, b in zip(after, before, strict=True))


def test_two_observations_that_contradict_each_other_remain_as_they_are() -> None:
    """Nobody knows which of them is wrong."""
    matches, tracks = drawn(np.random.default_rng(24), (1.0, 1.0, 1.0), cones=1)
    two = tracks[0].model_copy(update={"members": tracks[0].members[:2]})
    spoiled = [_moved(matches[0], 0.0, 20.0, 0.0), *matches[1:]]
    assert compared(spoiled, [two]) == spoiled
