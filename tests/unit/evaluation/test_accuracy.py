"""Statistics against truth on a drive with known errors: axes, bands, and NEES."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from conetl.evaluation.accuracy import (
    PointErrors,
    by_range,
    conditional_errors,
    drive_consistency,
    members_of,
    position_errors,
    select,
    statistics,
    track_errors,
)
from conetl.evaluation.nees_table import parts_of
from conetl.evaluation.truth import TruthCone, TruthLine, compare_with_truth
from conetl.geometry.calibration.covariance import calibration_jacobian
from conetl.geometry.consistency import leave_one_out_nees
from conetl.model.drive import Position, Track
from conetl.tracking.association import MotionError
from tests import records
from tests.synthetic.world import ORIGIN_M, calibrated, drive_of, make_path, make_rig

RIG = make_rig()
PAIRS = make_path(12, sigma_m=0.02)
DRIVE = drive_of(PAIRS, RIG)
PATH = np.add([pair.pose.map_t_body_m for pair in PAIRS], (0.8, 0.27, 1.65))


def truth_cones(count: int) -> list[TruthCone]:
    return [records.truth_cone(f"C{k}", np.add(ORIGIN_M, (16.0 + 2 * k, 3.0, 0.0))) for k in range(count)]


def make_track(index: int, xyz: np.ndarray, frames: range) -> Track:
    members = tuple((f, index) for f in frames)
    here = records.standing_at(xyz, cov_m2=records.cov_of(0.03))
    return records.track(index, len(frames), relative_cov_m2=records.cov_of(0.02), members=members, **here)


def make_position(frame: int, match: int, xyz: np.ndarray) -> Position:
    place = tuple(xyz.tolist())
    return records.position(
        frame, match, xyz_m=place, cov_m2=records.cov_of(0.07), centre_xyz_m=place, camera_xyz_m=(1.0, 1.0, 10.0),
        camera_cov_m2=(1e-4, 0, 0, 4e-4, 0, 25e-4), range_m=float(np.hypot(*(xyz - PATH[frame])[:2])),
    )  # fmt: skip


def lines_of(cones: list[TruthCone], shift: np.ndarray) -> list[TruthLine[Track]]:
    tracks = [make_track(k, np.array(cone.xyz_m) + shift, range(8)) for k, cone in enumerate(cones)]
    return compare_with_truth(cones, tracks, PATH)[0]


def positions_of(cones: list[TruthCone], shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> list[Position]:
    """Positions of the members of the tracks of `lines_of`."""
    return [make_position(f, k, np.add(cone.xyz_m, shift)) for k, cone in enumerate(cones) for f in range(8)]


def test_errors_by_axis() -> None:
    """The drive goes east: ahead is easting, left is northing; camera z is the range."""
    cones = truth_cones(3)
    lines = lines_of(cones, np.array([0.03, -0.01, 0.02]))
    singles = position_errors(members_of(lines), positions_of(cones, (0.2, 0.0, 0.05)), DRIVE)
    figures = statistics(singles)
    assert figures is not None
    assert figures.count == 24
    assert figures.bias_enu_m == pytest.approx((0.2, 0.0, 0.05))
    assert figures.rmse_3d_m == pytest.approx(np.hypot(0.2, 0.05))
    assert figures.bias_sight_m[0] == pytest.approx(0.2, abs=0.02)  # the line of sight is not exactly east
    assert figures.le90_m == pytest.approx(0.05)
    assert figures.ce90_m == pytest.approx(0.2)
    np.testing.assert_allclose(singles.own_cov_m2[:3, :3], np.diag([25e-4, 1e-4, 4e-4]), atol=1e-12)
    tracks = track_errors(lines, DRIVE, positions_of(cones))
    np.testing.assert_allclose(np.diag(tracks.common_cov), np.square([0.02, 0.02, 0.03, 5e-4, 5e-4, 5e-4]))
    assert sum(band.errors.count for band in by_range(singles)) == 24
    assert statistics(select(singles, np.zeros(24, dtype=bool))) is None


def test_cones_err_alike_by_poses_whose_errors_change_within_the_drive() -> None:
    """Each track states what its pose erred since the middle of the drive; cones of one frame err by it together."""
    cones, since_middle_m2 = truth_cones(3), 1e-4

    def changed_cov_m2(xyz_m: np.ndarray, frames: Sequence[Sequence[int]], shares: Sequence[np.ndarray]) -> np.ndarray:
        assert [list(own) for own in frames] == len(xyz_m) * [list(range(8))]
        np.testing.assert_allclose(np.sum(shares, axis=1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-12)
        return np.tile(since_middle_m2 * np.eye(3), (3, 3))

    motion = MotionError(lambda _start, _end, _point_m: np.zeros((3, 3)), changed_cov_m2=changed_cov_m2)
    own = track_errors(lines_of(cones, np.zeros(3)), DRIVE, positions_of(cones), motion).own_cov_m2
    np.testing.assert_allclose(own, 0.02**2 * np.eye(9) + since_middle_m2 * (np.tile(np.eye(3), (3, 3)) - np.eye(9)))


def test_a_shift_of_the_whole_drive_is_common_and_one_cone_off_is_relative() -> None:
    cones = truth_cones(6)
    shifted = drive_consistency(track_errors(lines_of(cones, np.array([0.3, 0.0, 0.0])), DRIVE, positions_of(cones)))
    assert shifted is not None
    assert shifted.relative.value == pytest.approx(0.0, abs=1e-9)
    assert not shifted.common.holds()
    lines = lines_of(cones, np.zeros(3))
    off = make_track(0, np.add(cones[0].xyz_m, (0.3, 0.0, 0.0)), range(8))
    lines[0] = TruthLine(cones[0], off, lines[0].truth_range_m, lines[0].range_m)
    alone = drive_consistency(track_errors(lines, DRIVE, positions_of(cones)))
    assert alone is not None
    assert not alone.relative.holds()
    assert alone.common.holds(0.9999)


def test_an_error_of_the_calibration_is_common_to_all_positions() -> None:
    """A right camera that is turned by one stated sigma shifts every range, the far ones most: no relative error at all."""
    rig = calibrated(RIG, {"relative.ry_rad": 1e-3})
    cones = truth_cones(5)
    cone_of, positions = {}, []
    for k, cone in enumerate(cones):
        for f in range(8):
            ahead, aside = np.subtract(cone.xyz_m, PATH[f])[:2]
            in_camera = np.array([[-aside, 1.65, ahead]])
            moved = calibration_jacobian(in_camera, rig)[0, :, 0] * 1e-3
            shift = np.array([moved[2], -moved[0], -moved[1]])
            x, y, z = in_camera[0].tolist()
            place = make_position(f, k, np.add(cone.xyz_m, shift))
            positions.append(place.model_copy(update={"camera_xyz_m": (x, y, z)}))
            cone_of[f, k] = cone
    stated = drive_consistency(position_errors(cone_of, positions, DRIVE.model_copy(update={"rig": rig})))
    not_stated = drive_consistency(position_errors(cone_of, positions, DRIVE))
    assert stated is not None
    assert not_stated is not None
    assert stated.common.dof == 7
    assert stated.relative.value < 0.05 * stated.relative.dof
    assert 0.5 < stated.common.value < 1.5
    assert not_stated.relative.value > 20 * max(stated.relative.value, 1e-3)


def test_a_class_is_judged_given_what_the_others_show_of_the_common_errors() -> None:
    """With errors drawn from the stated covariance the NEES of a class has the degrees of freedom of its objects. Of an offset
    of the drive by 30 cm, which all objects show, nearly nothing is left in each class."""
    rng, count = np.random.default_rng(8), 7
    common = np.concatenate([np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3, 3))], axis=2)
    common[:3, :, 3:] = 0.03 * np.eye(3)
    few, own = np.arange(count) < 3, 1e-4 * np.eye(3 * count)
    cov = np.diag([0.02**2] * 3 + [1.0] * 3)

    def errors(difference_m: np.ndarray) -> PointErrors:
        zero = np.zeros((count, 3))
        return PointErrors(tuple("abcdefg"), zero, difference_m, zero, own, zero[:, 0], zero, common, cov)

    drawn = 0.01 * rng.standard_normal((200, count, 3)) + np.einsum(
        "nij,dj->dni", common, rng.standard_normal((200, 6)) * np.sqrt(np.diag(cov))
    )
    for chosen, of_class in ((few, 3), (~few, 0)):
        nees = drive_consistency(*(conditional_errors(errors(one), chosen) for one in drawn))
        assert nees is not None
        assert (nees.absolute.dof, nees.common.dof) == (200 * 3 * chosen.sum(), 200 * of_class)
        assert nees.absolute.holds() and nees.relative.holds()
    off = conditional_errors(errors(drawn[0] + (0.3, 0.0, 0.0)), few)
    np.testing.assert_allclose(off.difference_m, conditional_errors(errors(drawn[0]), few).difference_m, atol=0.02)
    alone = conditional_errors(errors(drawn[0]), np.ones(count, dtype=bool))
    np.testing.assert_allclose(alone.difference_m, drawn[0], err_msg="without others nothing is known")
    np.testing.assert_allclose(alone.own_cov_m2, 1e-4 * np.eye(3 * count), atol=1e-9)


def test_without_found_cones_there_are_no_figures() -> None:
    lines: list[TruthLine[Track]] = [TruthLine(truth_cones(1)[0], None, 3.0, None)]
    tracks, singles = track_errors(lines, DRIVE, []), position_errors(members_of(lines), [], DRIVE)
    for errors in (tracks, singles):
        assert isinstance(errors, PointErrors)
        assert statistics(errors) is None
        assert drive_consistency(errors) is None
        assert by_range(errors) == []
        assert leave_one_out_nees(errors.difference_m, errors.joint_cov_m2()).shape == (0,)
    assert set(parts_of(None).values()) == {None}
