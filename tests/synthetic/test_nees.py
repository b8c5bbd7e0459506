"""The covariances of whole drives hold: NEES of simulated drives against the chi-square band, which wrong sigmas must leave.

`noise` multiplies the true image noise while the stated sigmas stay: 2 is sigmas stated half as large as they are, 0.5 double.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pytest

from conetl.evaluation.accuracy import drive_consistency, position_errors, track_errors
from conetl.evaluation.truth import TruthCone, compare_with_truth
from conetl.geometry import pose as se3
from conetl.geometry.consistency import Consistency, Nees
from conetl.geometry.packing import cov_matrix
from conetl.geometry.rig import map_SE3_left
from conetl.model.drive import Track
from conetl.model.params import PositionParams, TrajectoryParams
from conetl.tracking.error_propagation import outline_errors, pose_cov
from conetl.tracking.positions import locate_positions
from conetl.tracking.trajectory import RefinementOutcome, refine_trajectory
from tests.cases import cases
from tests.synthetic.noisy_drive import EXACT_MOTION, NoisyDrive, draw_drive, draw_positions
from tests.synthetic.odometry import log_of, motions_of
from tests.synthetic.world import Cone, fuse_logged, make_path, make_rig

RIG = make_rig()
CONES = [Cone((14.0 + 4.0 * k, 3.6 - 0.5 * k, 0.0)) for k in range(5)]
PARAMS = TrajectoryParams()


def summed(results: Iterable[Consistency | None]) -> Consistency:
    total = Consistency(Nees(0.0, 0), Nees(0.0, 0), Nees(0.0, 0))
    for one in results:
        assert one is not None
        total = Consistency(total.absolute + one.absolute, total.relative + one.relative, total.common + one.common)
    return total


def of_positions(drive: NoisyDrive) -> Consistency | None:
    cone_of = {(p.frame_index, p.match_index): drive.truth[p.match_index] for p in drive.positions}
    return drive_consistency(position_errors(cone_of, drive.positions, drive.drive))


def of_tracks(drive: NoisyDrive) -> Consistency | None:
    path = np.array([map_SE3_left(pair.pose, RIG)[:3, 3] for pair in drive.drive.frame_pairs])
    # One innovation in a thousand lies beyond the association's gate: now and then a cone has two tracks, the longer is its own.
    longest = [
        max(near, key=lambda t: t.observation_count) for cone in drive.truth if (near := _near(cone, drive.tracks))
    ]
    lines, _ = compare_with_truth(drive.truth, longest, path)
    assert sum(line.feature is not None for line in lines) == len(drive.truth)
    return drive_consistency(track_errors(lines, drive.drive, drive.positions))


def _near(cone: TruthCone, tracks: Sequence[Track]) -> list[Track]:
    return [track for track in tracks if np.linalg.norm(np.subtract(track.xyz_m, cone.xyz_m)) < 0.7]


@pytest.mark.parametrize(
    ("noise", "drives", "holds"), cases((1.0, 8, True), release=[(0.5, 5, False), (2.0, 5, False)])
)
def test_single_positions_from_refined_poses_that_slide(noise: float, drives: int, holds: bool) -> None:
    """Poses from the adjustment of the trajectory, log and odometry with errors as they state: they change within the drive.

    With their joint covariance all parts hold. As one constant error of the drive they do not: what slides looks like noise.
    """
    pairs = make_path(16)
    truth = np.stack([se3.map_SE3_body(pair.pose) for pair in pairs])
    jointly, as_one = [], []
    for seed in range(drives):
        rng = np.random.default_rng(seed)
        drawn = draw_positions(rng, RIG, CONES, frames=len(pairs), noise=noise)
        refined = refine_trajectory(
            log_of(truth, rng, 0.06, 0.001, PARAMS), RIG, motions_of(truth, RIG, rng, PARAMS), PARAMS
        )
        assert refined.outcome is RefinementOutcome.REFINED
        drive = drawn.drive.model_copy(update={"frame_pairs": refined.frame_pairs})
        positions, _ = locate_positions(drawn.matches, refined.frame_pairs, RIG, PositionParams())
        cone_of = {(p.frame_index, p.match_index): drawn.truth[p.match_index] for p in positions}
        jointly.append(drive_consistency(position_errors(cone_of, positions, drive, pose_cov(refined, PARAMS))))
        as_one.append(drive_consistency(position_errors(cone_of, positions, drive)))
    for part in ("relative", "absolute"):
        assert getattr(summed(jointly), part).holds() is holds
    assert summed(jointly).common.holds(0.999) or not holds
    if holds:
        assert not summed(as_one).relative.holds(0.9999)


@pytest.mark.parametrize(("noise", "holds"), cases((1.0, True), (2.0, False), release=[(0.5, False)]))
def test_what_all_sightings_of_a_cone_share_is_common_to_them(noise: float, holds: bool) -> None:
    """Feet that the detector puts wrongly, for each cone in all its images alike: single positions and tracks hold."""
    some = [
        draw_drive(np.random.default_rng(seed), RIG, CONES, frames=16, noise=noise, outline_px=0.6)
        for seed in range(20, 28)
    ]
    singles, tracks = summed(of_positions(drive) for drive in some), summed(of_tracks(drive) for drive in some)
    for part in (singles.relative, singles.absolute, singles.common, tracks.relative, tracks.absolute):
        assert part.holds(0.999) is holds
    shares = {p.sigma_outline_m / p.camera_xyz_m[2] for drive in some for p in drive.positions}
    assert np.ptp(list(shares)) < 1e-9


@pytest.mark.parametrize("count", [4, 16])
def test_what_sightings_share_counts_once_in_a_track(count: int) -> None:
    """A vehicle that waits beside a cone: the disparities' own error averages out over the frames, what they share does not."""
    drawn = draw_positions(np.random.default_rng(1), RIG, CONES[:1], frames=1, noise=0.0, outline_px=0.6)
    [pair], [match], [position] = drawn.drive.frame_pairs, drawn.matches, drawn.positions
    pairs = [pair.model_copy(update={"frame_index": k, "captured_at_ns": k * 10**8}) for k in range(count)]
    boxes = [{side: getattr(match, side).model_copy(update={"frame_index": k}) for side in ("left", "right")}
             for k in range(count)]  # fmt: skip
    [track], _ = fuse_logged(
        pairs,
        RIG,
        [box for both in boxes for box in both.values()],
        [match.model_copy(update={"frame_index": k, **both}) for k, both in enumerate(boxes)],
        [position.model_copy(update={"frame_index": k}) for k in range(count)],
        motion=EXACT_MOTION,
    )
    turn = map_SE3_left(pair.pose, RIG)[:3, :3]
    away = turn @ np.array([0.0, 0.0, 1.0])
    shared = away @ turn @ outline_errors(position, RIG)
    alone = away @ turn @ cov_matrix(position.camera_cov_m2) @ turn.T @ away
    expected = shared @ shared + (alone - shared @ shared) / count
    assert away @ cov_matrix(track.relative_cov_m2) @ away == pytest.approx(expected, rel=5e-3)
