"""Control points in the adjustment: true sigmas, logs that are wrong, and points that are wrong."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from conetl.checks.verdict import judge
from conetl.evaluation.truth import read_truth_cones
from conetl.geometry import pose as se3
from conetl.geometry.packing import cov_matrix
from conetl.model.drive import Drive, FramePair, SurveyedPoint
from conetl.model.errors import DriveFolderError
from conetl.model.health import HealthCheck, Verdict
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.pipeline.analysis import AnalysedDrive, analyse
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from conetl.tracking.control_points import refine_with_control
from conetl.tracking.trajectory import RefinedTrajectory
from tests.cases import cases
from tests.synthetic.noisy_drive import draw_positions
from tests.synthetic.odometry import log_of, motions_of, pose_errors
from tests.synthetic.world import ORIGIN_M, Cone, make_path, make_rig, shifted
from tests.unit.readers.drive_formats import SAMPLE

RIG, PARAMS = make_rig(), TrajectoryParams()
CONES = [Cone((12.0 + 4.0 * k, 3.2 - 6.0 * (k % 2), 0.0)) for k in range(6)]
TRUTH = np.stack([se3.map_SE3_body(pair.pose) for pair in make_path(32)])
OFF_M = np.array([0.4, 0.3, 0.2])


def surveyed(
    feet: np.ndarray, rng: np.random.Generator, wrong: dict[int, tuple[float, float, float]] | None = None
) -> list[SurveyedPoint]:
    return [
        SurveyedPoint(
            name=f"P{n}", xyz_m=tuple((foot + rng.normal(0, 0.01, 3) + (wrong or {}).get(n, 0.0)).tolist()),
            sigma_m=(0.01, 0.01, 0.01),
        )
        for n, foot in enumerate(feet)
    ]  # fmt: skip


def moved(pairs: list[FramePair] | tuple[FramePair, ...], off_m: np.ndarray, sigma_m: float | None) -> list[FramePair]:
    """Frame pairs whose logged positions are off by (K, 3), and state another sigma."""
    wrong = [shifted(pair, off) for pair, off in zip(pairs, off_m, strict=True)]
    if sigma_m is None:
        return wrong
    stated = {"sigma_enu_m": (sigma_m,) * 3}
    return [pair.model_copy(update={"pose": pair.pose.model_copy(update=stated)}) for pair in wrong]


def refined(
    seed: int, off_m: np.ndarray, sigma_m: float, points: list[int], wrong: dict[int, tuple[float, float, float]]
) -> tuple[RefinedTrajectory, np.ndarray]:
    """The trajectory of a drawn drive whose log states sigma_m and is off_m away, with points on these cones; errors (K, 3)."""
    rng = np.random.default_rng(seed)
    matches = draw_positions(rng, RIG, CONES).matches
    log, motions = log_of(TRUTH, rng, sigma_m, 0.0009, PARAMS), motions_of(TRUTH, RIG, rng, PARAMS)
    log = moved(log, np.tile(off_m, (len(log), 1)), None)
    feet = np.add([CONES[n].foot_m for n in points], ORIGIN_M)
    result = refine_with_control(log, RIG, motions, matches, IngestParams(), surveyed(feet, rng, wrong))
    return result, pose_errors(result.frame_pairs, TRUTH)[:, :3]


def control_of(trajectory: RefinedTrajectory) -> HealthCheck:
    assert trajectory.control is not None
    return judge(trajectory.control)


def test_a_cone_that_is_surveyed_twice_is_named() -> None:
    control = control_of(refined(1, np.zeros(3), 0.02, [0, 2, 4, 0], {})[0])
    assert control.verdict is Verdict.NOTE
    assert "one cone is surveyed twice (P0 and P3)" in control.detail


def test_sigmas_of_poses_hold() -> None:
    """NEES of a pose in the middle, with a log of 0.4 m. Cones have equal errors in all their images, which drawn ones do
    not, so that it is below 1."""
    nees, errors_m = [], []
    for seed in range(3):
        result, error = refined(seed, np.zeros(3), 0.4, [0, 2, 4], {})
        assert result.covariance is not None
        assert control_of(result).verdict is Verdict.PASS, control_of(result).detail
        nees.append(error[12] @ np.linalg.solve(result.covariance.of(12)[:3, :3], error[12]) / 3)
        errors_m.append(np.linalg.norm(error[12]))
    assert 0.1 < np.mean(nees) < 1.25
    assert np.mean(errors_m) < 0.08


@pytest.mark.parametrize(
    ("sigma_m", "points", "wrong", "verdict", "says"),
    cases(
        (0.5, [0, 2, 4], {1: (0.7, 0.7, 0.0)}, Verdict.NOTE, "contradict them: P1 ("),
        (0.02, [0, 2, 3, 4], {1: (0.7, 0.7, 0.0)}, Verdict.NOTE, "GNSS/INS differs from them by 0.5"),
        (0.02, [0, 2, 3, 4], {}, Verdict.NOTE, "sigmas of both): one of the two"),
        (0.5, [0, 4], {1: (0.7, 0.7, 0.0)}, Verdict.HOLD, "contradict each other"),
        (0.02, [0, 2, 3, 4], dict.fromkeys(range(4), (0.4, 0.3, 0.9)), Verdict.HOLD, "in height only"),  # tips of cones
        (0.02, [0, 4], {}, Verdict.HOLD, "P0 (0.5"),  # two do not contradict a log
        (0.5, [0, 4], dict.fromkeys(range(2), (500.0, 0.0, 0.0)), Verdict.NOTE, "None of the 2 control points"),
        release=[(0.5, [0, 2, 4], {2: (0.0, 0.0, 0.5)}, Verdict.NOTE, "contradict them: P2 (")],
    ),
)
def test_wrong_points_are_named_and_not_believed(
    sigma_m: float, points: list[int], wrong: dict[int, tuple[float, float, float]], verdict: Verdict, says: str
) -> None:
    result, error = refined(3, OFF_M, sigma_m, points, wrong)
    control = control_of(result)
    assert control.verdict is verdict and says in control.detail, control
    if verdict is Verdict.NOTE and control.value:
        assert np.linalg.norm(error[12]) < 0.1


@pytest.fixture(scope="module")
def sample() -> tuple[Drive, np.ndarray]:
    cones, _ = read_truth_cones(SAMPLE / "truth.csv")
    return read_drive(SAMPLE)[0], np.array([cone.xyz_m for cone in cones])


def largest_chi2(found: AnalysedDrive, feet: np.ndarray) -> float:
    """Of the cones against their true feet."""
    chi2 = []
    for track in found.tracks:
        error = np.array(track.xyz_m) - feet[np.linalg.norm(feet - track.xyz_m, axis=1).argmin()]
        chi2.append(float(error @ np.linalg.solve(cov_matrix(track.cov_m2), error)))
    assert len(chi2) == len(feet)
    return max(chi2)


@pytest.mark.parametrize(("drifts", "sigma_m"), cases((True, None), release=[(False, 0.5)]))
def test_three_points_correct_a_log_that_is_half_a_metre_off(
    drifts: bool, sigma_m: float | None, sample: tuple[Drive, np.ndarray], sample_settings: Settings
) -> None:
    """Also where it states 2 cm and drifts: then the check says so."""
    drive, feet = sample
    share = np.linspace(0, 1, len(drive.frame_pairs)) if drifts else np.ones(len(drive.frame_pairs))
    pairs = moved(drive.frame_pairs, share[:, None] * OFF_M, sigma_m)
    points = surveyed(feet[[0, 3, 6]], np.random.default_rng(1))
    changed = drive.model_copy(update={"frame_pairs": tuple(pairs), "control_points": tuple(points)})
    found = analyse(changed, settings=sample_settings)
    control = control_of(found.trajectory)
    assert control in found.health
    assert control.verdict is (Verdict.PASS if sigma_m else Verdict.CORRECTED)
    assert ("it drifts, or jumps" in control.detail) is not bool(sigma_m)
    assert largest_chi2(found, feet) < 7.8  # 5 % of 3 degrees of freedom, far below for the median of the cones
    errors = [np.linalg.norm(feet - track.xyz_m, axis=1).min() for track in found.tracks]
    assert max(errors) < 0.05


def test_the_file_is_named_in_drive_yaml(tmp_path: Path, sample: tuple[Drive, np.ndarray]) -> None:
    drive, feet = sample
    copy = tmp_path / "run"
    shutil.copytree(SAMPLE, copy)
    rows = [f"K{n},{e},{north},{h}" for n, (e, north, h) in enumerate(feet[:3].tolist())]
    (copy / "points.csv").write_text("\n".join(["name,easting,northing,height_m", *rows]))
    (copy / "drive.yaml").write_text(
        f"control_points: {{file: points.csv, crs: 'EPSG:{drive.map_srid}', sigma_m: 0.02}}\n"
    )
    found, _ = read_drive(copy)
    assert [point.name for point in found.control_points] == ["K0", "K1", "K2"]
    assert np.array([point.xyz_m for point in found.control_points]) == pytest.approx(feet[:3], abs=1e-4)
    (copy / "points.csv").write_text((copy / "points.csv").read_text().replace("K0", "K9"))
    assert read_drive(copy)[0].content_sha256 != found.content_sha256
    (copy / "drive.yaml").write_text("control_points: points.csv\n")
    with pytest.raises(DriveFolderError, match=r"points\.csv: does not state a coordinate reference system"):
        read_drive(copy)
    (copy / "drive.yaml").write_text("control_points: other.csv\n")
    with pytest.raises(DriveFolderError, match="the control points are missing"):
        read_drive(copy)
