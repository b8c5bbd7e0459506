"""Ten drives of one rig, which was calibrated once: do the places on the map err as much as they state?

Each trial draws one error of the calibration and compares ten drives with the map, one after the other, through `reconcile`.
Every drive has a GNSS error of its own, which puts it aside as a whole. NEES: squared errors in the sigmas that the map states,
over 3; 1 where these are right. And twenty drives of one base station, whose error they share.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from conetl.geometry.calibration.covariance import calibration_jacobian, jacobian_of, pack_jacobians, unpack_jacobians
from conetl.geometry.packing import cov3, cov_matrix
from conetl.geometry.rig import map_SE3_left
from conetl.mapping.changes import reconcile
from conetl.mapping.deltas import ReconcileContext
from conetl.model.drive import CommonError, Track
from conetl.model.map_records import MapFeature
from conetl.model.params import ReconcileParams
from conetl.model.rig import Rig
from conetl.tracking.error_propagation import common_axes, common_error_id
from tests import records
from tests.cases import cases
from tests.synthetic.world import ORIGIN_M, START_NS, calibrated, make_path, make_rig

Floats = NDArray[np.float64]
PARAMS = ReconcileParams()
DRIVES = 10
SIGMAS = {"left.fx_px": 0.5, "right.cx_px": 0.25, "relative.ry_rad": 2.5e-4, "relative.tx_m": 1e-3}
#: GNSS of a drive, and of a cone within it, one axis.
DRIVE_M, CONE_M = 0.03, 0.01
#: From which even and odd drives see a cone.
RANGES_M = (8.0, 8.2)


RIG = calibrated(make_rig(), SIGMAS)


def eastwards(_drive: int) -> bool:
    return True


def to_and_fro(drive: int) -> bool:
    return drive % 2 == 0


def one_track(
    index: int, cone_m: Floats, drive: int, rig: Rig, off_m: Floats, z: Floats, range_m: float, *, east: bool
) -> Track:
    """A cone seen from `range_m` before it; off_m (3,): what is the drive's own; z: errors of the calibration, in sigmas."""
    [pair] = make_path(1, east=east)
    before_m = range_m if east else -range_m
    turn = map_SE3_left(pair.pose, rig)[:3, :3]
    in_camera = turn.T @ np.array([before_m, cone_m[1], -1.6])
    by_calibration = turn @ calibration_jacobian(in_camera[None], rig)[0]
    shared_jacobian = jacobian_of(by_calibration, rig)
    assert shared_jacobian is not None
    moved = unpack_jacobians(shared_jacobian.calibrations, [shared_jacobian])[0, 0]
    at = ORIGIN_M + cone_m + off_m + moved @ z
    own = np.eye(3) * (DRIVE_M**2 + CONE_M**2)
    return records.track(
        index,
        10,
        seen_ns=START_NS + drive * records.DAY_NS,
        relative_cov_m2=records.cov_of(CONE_M),
        existence_probability=0.95,
        members=((index, 0),),
        shared_jacobian=shared_jacobian,
        **records.standing_at(at, cov_m2=cov3(own + moved @ moved.T)),
    )


def after(drives: Sequence[Sequence[Track]]) -> list[MapFeature]:
    """The map that the drives make."""
    standing: dict[object, MapFeature] = {}
    for number, tracks in enumerate(drives):
        for delta in reconcile(
            tracks, list(standing.values()), lambda *_: None, ReconcileContext(PARAMS, f"drive {number}")
        ):
            assert delta.new is not None
            standing[delta.feature_id] = delta.new
    return list(standing.values())


def errors_of(features: Sequence[MapFeature], cones_m: Floats) -> tuple[Floats, Floats]:
    """(N, 3) m and NEES (N,) of the cones; all of them, and nothing else, must be on the map."""
    assert len(features) == len(cones_m)
    off_m, nees = [], []
    for cone_m in cones_m:
        nearest = min(features, key=lambda f: float(np.hypot(*np.subtract(f.xyz_m, ORIGIN_M + cone_m)[:2])))
        off = np.subtract(nearest.xyz_m, ORIGIN_M + cone_m)
        off_m.append(off)
        nees.append(float(off @ np.linalg.solve(cov_matrix(nearest.cov_m2), off)) / 3)
    return np.array(off_m), np.array(nees)


def nees(
    east: Callable[[int], bool],
    rigs_of_drives: Sequence[Rig],
    *,
    cones: int,
    trials: int = 150,
    known: bool = True,
    seen: Callable[[int, int], bool] = lambda _drive, _cone: True,
    of_cone: int | None = None,
) -> tuple[float, float]:
    """Mean NEES over trials and cones (or of one), and the mean sigma along the road in metres.

    known: False as if no drive told its shared_jacobian. seen: whether a drive sees a cone.
    """
    rng = np.random.default_rng(12)
    cones_m = np.array([[12.0 * k, 2.5 if k % 2 else -2.5, 0.0] for k in range(cones)])
    total, sigma_m = [], []
    for _ in range(trials):
        errors = {rig.model_dump_json(): rng.normal(size=len(SIGMAS)) for rig in rigs_of_drives}
        drives = []
        for drive in range(len(rigs_of_drives)):
            rig, gnss_m = rigs_of_drives[drive], rng.normal(0, DRIVE_M, 3)
            z = errors[rig.model_dump_json()]
            tracks = [
                one_track(
                    k, cone_m, drive, rig, gnss_m + rng.normal(0, CONE_M, 3), z, RANGES_M[drive % 2], east=east(drive)
                )
                for k, cone_m in enumerate(cones_m)
                if seen(drive, k)
            ]  # fmt: skip
            drives.append(tracks if known else [track.model_copy(update={"shared_jacobian": None}) for track in tracks])
        features = after(drives)
        found = errors_of(features, cones_m)[1]
        total.append(found.mean() if of_cone is None else found[of_cone])
        sigma_m.append(np.mean([f.cov_m2[0] ** 0.5 for f in features]))
    return float(np.mean(total)), float(np.mean(sigma_m))


@pytest.mark.release
def test_ten_drives_from_one_side_state_what_they_have_in_common() -> None:
    honest, sigma_m = nees(eastwards, [RIG] * DRIVES, cones=3)
    proud, proud_m = nees(eastwards, [RIG] * DRIVES, cones=3, trials=40, known=False)
    assert 0.8 < honest < 1.25
    assert proud > 2.5
    assert sigma_m > 2 * proud_m


@pytest.mark.release
def test_a_cone_that_a_drive_from_the_other_side_adds_is_off_as_the_map_is() -> None:
    """It is placed against the cones that were there: the shared_jacobian of its own drive would be cancelled by the next
    ones."""
    late = nees(to_and_fro, [RIG] * 5, cones=3, seen=lambda drive, cone: cone < 2 or drive >= 3, of_cone=2)[0]
    assert 0.8 < late < 1.25


CONES_M = np.array([[12.0 * k, 3.0 * (k % 2), 0.0] for k in range(5)])


class Figures(NamedTuple):
    """Means over trials."""

    nees_of_first: float
    """Squared error of a cone that all drives saw, in the sigmas that the map states, over 3."""
    nees_of_late: float
    """Of the one that was added later."""
    apart_m: float
    """Root mean square error of the way between the two, horizontally."""


def put_aside(index: int, off_m: Floats, drive: int, drive_m: float, cone_m: float) -> Track:
    at = records.standing_at(ORIGIN_M + CONES_M[index] + off_m, cov_m2=records.cov_of(float(np.hypot(drive_m, cone_m))))
    seen_ns = START_NS + drive * records.DAY_NS
    return records.track(
        index,
        10,
        seen_ns=seen_ns,
        relative_cov_m2=records.cov_of(cone_m),
        existence_probability=0.95,
        members=((index, 0),),
        **at,
    )


def figures(late_from: int, drive_m: float, cone_m: float) -> Figures:
    """drive_m, cone_m: sigmas of a drive as a whole and of a cone in it, one axis; the last cone is there from that drive on."""
    rng = np.random.default_rng(1)
    rows = []
    for _ in range(60):
        drives = []
        for drive in range(DRIVES):
            # An offset beyond four sigmas is not believed, which is right, and would happen to one drive in some thousand.
            gnss_m = np.clip(rng.normal(0, drive_m, 3), -2.5 * drive_m, 2.5 * drive_m)
            drives.append(
                [
                    put_aside(k, gnss_m + rng.normal(0, cone_m, 3), drive, drive_m, cone_m)
                    for k in range(len(CONES_M))
                    if k < len(CONES_M) - 1 or drive >= late_from
                ]
            )
        off, nees = errors_of(after(drives), CONES_M)
        rows.append((nees[0], nees[-1], float(np.sum((off[-1] - off[0])[:2] ** 2))))
    first, late, squared = np.mean(rows, axis=0).tolist()
    return Figures(first, late, squared**0.5)


@pytest.mark.parametrize(
    ("late_from", "drive_m", "cone_m"),
    cases((9, 0.2, 0.02), release=[(1, 0.05, 0.01), (9, 0.05, 0.01), (1, 0.2, 0.02)]),
)
def test_the_map_states_its_errors_and_keeps_cones_together(late_from: int, drive_m: float, cone_m: float) -> None:
    """Where a difference was shared out twice, between drive and map and again between place and place, NEES was above 3."""
    found = figures(late_from, drive_m, cone_m)
    assert 0.8 < found.nees_of_first < 1.25
    assert 0.8 < found.nees_of_late < 1.25
    # What its own sightings allow; the drives as a whole are off by ten times as much.
    assert found.apart_m < 2.0 * cone_m


BASE_M, BASE_DRIVES = 0.02, 20


def of_base(
    errors: Sequence[CommonError], headings_deg: Sequence[float], trials: int = 40
) -> tuple[float, float, float]:
    """NEES of the cones of drives with these common errors and headings, and the root mean square of the stated horizontal sigma
    and of the true error (m, one axis). Each id has one error for all drives."""
    rng = np.random.default_rng(5)
    found, sigmas_m, errors_m = [], [], []
    for _ in range(trials):
        z = {common_error_id(one): rng.normal(size=3) for one in errors}
        drives = []
        for drive, (error, heading_deg) in enumerate(zip(errors, headings_deg, strict=True)):
            turn = Rotation.from_euler("z", heading_deg, degrees=True).as_matrix()
            moved = common_axes(error, turn[None])[0]
            [jacobian] = pack_jacobians((common_error_id(error),), moved[None, None])
            own_m2 = (DRIVE_M**2 + CONE_M**2) * np.eye(3)
            gnss_m = moved @ z[common_error_id(error)] + rng.normal(0, DRIVE_M, 3)
            drives.append(
                [
                    put_aside(k, gnss_m + rng.normal(0, CONE_M, 3), drive, DRIVE_M, CONE_M).model_copy(
                        update={"cov_m2": cov3(own_m2 + moved @ moved.T), "shared_jacobian": jacobian}
                    )
                    for k in range(len(CONES_M))
                ]
            )
        features = after(drives)
        off_m, nees = errors_of(features, CONES_M)
        found.append(nees.mean())
        sigmas_m.append(np.mean([(f.cov_m2[0] + f.cov_m2[3]) / 2 for f in features]))
        errors_m.append(np.mean(off_m[:, :2] ** 2))
    nees_mean, stated_m2, true_m2 = (float(np.mean(values)) for values in (found, sigmas_m, errors_m))
    return nees_mean, stated_m2**0.5, true_m2**0.5


def base(name: str, axes: Literal["map", "vehicle"] = "map") -> CommonError:
    return CommonError(id=name, sigma_m=(BASE_M,) * 3, axes=axes)


def test_twenty_drives_of_one_base_station_never_state_less_than_its_error() -> None:
    nees, stated_m, true_m = of_base([base("north")] * BASE_DRIVES, [0.0] * BASE_DRIVES)
    assert stated_m > BASE_M
    assert stated_m == pytest.approx((BASE_M**2 + (DRIVE_M**2 + CONE_M**2) / BASE_DRIVES) ** 0.5, rel=0.1)
    assert stated_m == pytest.approx(true_m, rel=0.15)
    assert 0.8 < nees < 1.25


@pytest.mark.release
def test_drives_of_two_base_stations_average_over_both() -> None:
    nees, stated_m, _ = of_base([base("north"), base("south")] * (BASE_DRIVES // 2), [0.0] * BASE_DRIVES)
    assert stated_m == pytest.approx((BASE_M**2 / 2 + (DRIVE_M**2 + CONE_M**2) / BASE_DRIVES) ** 0.5, rel=0.1)
    assert 0.8 < nees < 1.25


def test_a_lever_arm_cancels_in_drives_of_opposite_directions() -> None:
    antenna = [base("roof antenna", "vehicle")] * BASE_DRIVES
    one_way, stated_m, _ = of_base(antenna, [30.0] * BASE_DRIVES)
    both_ways, cancelled_m, _ = of_base(antenna, [30.0, 210.0] * (BASE_DRIVES // 2))
    assert stated_m > BASE_M > 2 * cancelled_m
    assert 0.8 < one_way < 1.25 and 0.8 < both_ways < 1.25
