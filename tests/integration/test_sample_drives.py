"""The sample drives by the real detector: their covariances hold, and right images that are searched in part cost nothing."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from conetl.cli.tools.evaluate import analyse_folder
from conetl.evaluation.accuracy import PointErrors, drive_consistency, members_of, position_errors
from conetl.evaluation.truth import compare_with_truth, read_truth_cones
from conetl.geometry.rig import map_SE3_left
from conetl.mapping.changes import reconcile
from conetl.mapping.deltas import ReconcileContext
from conetl.mapping.visibility import check_visibility, observations_of_drive
from conetl.model.base import Record
from conetl.model.detector_evidence import AbsenceFigures
from conetl.model.errors import DriveFolderError
from conetl.model.feature_classes import CONE
from conetl.model.map_records import DeltaKind
from conetl.model.params import DetectionParams, IngestParams, MatchParams, ReconcileParams, TrackParams
from conetl.perception.model_card import read_model_card
from conetl.pipeline.analysis import AnalysedDrive
from conetl.pipeline.chunks import Chunk
from conetl.pipeline.detect import detect
from conetl.pipeline.settings import Settings
from conetl.tracking.matching.epipolar_search import blocks_of
from conetl.tracking.positions import locate_positions
from conetl.tracking.variance_components import VarianceFactors, with_variance_factors
from tests.cases import cases
from tests.integration.small_drives import SAMPLES, spoil_huffman_table

PARAMS = IngestParams()


@pytest.fixture(scope="module")
def sightings(sample_settings: Settings) -> dict[Path, AnalysedDrive]:
    """What the steps make of each drive."""
    found = {}
    for drive in SAMPLES:
        srid = read_truth_cones(drive / "truth.csv")[1]
        found[drive] = analyse_folder(drive, sample_settings, PARAMS, map_srid=srid)
    return found


def errors_of(truth: Path, results: AnalysedDrive, factor: float) -> PointErrors:
    """Of single positions, with the sigmas of all image points multiplied by a factor."""
    drive = results.drive
    # What all sightings of a cone have in common of its disparity is a constant, which is not theirs to state.
    scaled = with_variance_factors(results.records.matches, {CONE: VarianceFactors(factor**2, factor**2, factor**2)})
    matches = [m.model_copy(update={"sigma_outline_px": factor * m.sigma_outline_px}) for m in scaled]
    positions, _ = locate_positions(matches, drive.frame_pairs, drive.rig, PARAMS.position)
    path_m = np.array([map_SE3_left(pair.pose, drive.rig)[:3, 3] for pair in drive.frame_pairs])
    lines, _ = compare_with_truth(read_truth_cones(truth)[0], results.tracks, path_m)
    return position_errors(members_of(lines), positions, drive, results.poses)


@pytest.mark.parametrize(("factor", "holds"), cases((1.0, True), (2.0, False), release=[(0.5, False)]))
def test_sigmas_of_three_drives_together(sightings: dict[Path, AnalysedDrive], factor: float, holds: bool) -> None:
    """In the 95 % band of the summed degrees of freedom, which sigmas of half or double size leave."""
    errors = [errors_of(drive / "truth.csv", results, factor) for drive, results in sightings.items()]
    together = drive_consistency(*errors)
    assert together is not None
    assert together.relative.dof > 1000
    assert together.relative.holds() is holds
    assert together.absolute.holds() is holds
    assert together.common.holds() is holds


def test_sigmas_of_object_heights_hold(sightings: dict[Path, AnalysedDrive]) -> None:
    """Their errors have a part in common, so that the mean square is no chi-square of 29."""
    in_sigmas = []
    for drive, results in sightings.items():
        path_m = np.array([map_SE3_left(pair.pose, results.drive.rig)[:3, 3] for pair in results.drive.frame_pairs])
        lines, _ = compare_with_truth(read_truth_cones(drive / "truth.csv")[0], results.tracks, path_m)
        pairs = [(line.truth.cone_height_m, line.feature) for line in lines if line.feature is not None]
        in_sigmas += [(found.object_height_m - true_m) / found.object_height_sigma_m for true_m, found in pairs]
    assert len(in_sigmas) > 25
    assert 0.5 < np.mean(np.square(in_sigmas)) < 1.6


DRIVE = SAMPLES[0]
EVERYWHERE = PARAMS.model_copy(update={"detection": DetectionParams(search_right="everywhere")})


@pytest.fixture(scope="module")
def results(sightings: dict[Path, AnalysedDrive]) -> AnalysedDrive:
    return sightings[DRIVE]


def test_the_same_cones_at_the_same_places(sample_settings: Settings, results: AnalysedDrive) -> None:
    whole = analyse_folder(DRIVE, sample_settings, EVERYWHERE)
    count = {
        side: [sum(d.side == side for d in r.records.detections) for r in (whole, results)]
        for side in ("left", "right")
    }
    assert count["left"][0] == count["left"][1]
    assert count["right"][1] == pytest.approx(count["right"][0], rel=0.05)
    assert len(results.records.matches) == pytest.approx(len(whole.records.matches), rel=0.02)
    ours, theirs = (np.array([t.xyz_m for t in r.tracks]) for r in (results, whole))
    assert len(ours) == len(theirs)
    apart = np.linalg.norm(ours[:, None] - theirs[None], axis=2).min(axis=1)
    assert np.median(apart) < 0.002 and apart.max() < 0.03


@pytest.mark.parametrize("covered", cases("image_03", release=["image_02"]))
def test_a_covered_lens_removes_nothing(
    tmp_path: Path, sample_settings: Settings, results: AnalysedDrive, covered: str
) -> None:
    """What one camera still shows is not gone, whichever it is: a drive with one of them covered tells nothing."""
    drive = _with_covered(covered, tmp_path)
    assert _removed_by(drive, sample_settings, results) == 0


def test_a_covered_lens_removes_nothing_beside_broken_images(
    tmp_path: Path, sample_settings: Settings, results: AnalysedDrive
) -> None:
    """Just those right images that were to tell whether the others need to be searched."""
    drive = _with_covered("image_02", tmp_path)
    for frame_pairs in (results.drive.frame_pairs[:20], results.drive.frame_pairs[20:]):
        for middle, _ in blocks_of(len(frame_pairs), PARAMS):
            spoil_huffman_table(drive / "image_03" / "data" / Path(frame_pairs[middle].right_path).name)
    assert _removed_by(drive, sample_settings, results) == 0


def test_a_drive_without_a_whole_right_image_looks_at_nothing(
    tmp_path: Path, sample_settings: Settings, results: AnalysedDrive
) -> None:
    """Not even at an empty street, where no right image but those of some pairs would have to be searched."""
    drive = _with_covered("image_02", tmp_path)
    for path in (drive / "image_03" / "data").iterdir():
        spoil_huffman_table(path)
    with pytest.raises(DriveFolderError, match=r"none of \d+ frame pairs"):
        _removed_by(drive, sample_settings, results)


def test_detections_are_known_by_all_that_says_what_is_searched(tmp_path: Path, results: AnalysedDrive) -> None:
    changes: tuple[dict[str, Record], ...] = (
        {},
        {"reconcile": ReconcileParams(removal_min_frames=4)},
        {"reconcile": ReconcileParams(visible_min_height_px=30.0)},
        {"reconcile": ReconcileParams(visible_border_px=30.0)},
        {"track": TrackParams(max_cone_height_m=0.8)},
        {"match": MatchParams(max_range_m=20.0)},
        {"detection": DetectionParams(search_right="everywhere")},
    )
    chunk = Chunk(
        drive_id="one",
        rig=results.drive.rig, frame_pairs=results.drive.frame_pairs[:1],
        results_folder=tmp_path, model_path=None, detections_sha256=read_model_card(None).detections_sha256, params=PARAMS,
    )  # fmt: skip
    others = [chunk.model_copy(update={"params": PARAMS.model_copy(update=changed)}) for changed in changes]
    assert len({detect(other, 0, other.rig).detections for other in others}) == len(changes)


def _with_covered(covered: str, folder: Path) -> Path:
    """The drive with one of its cameras in the dark."""
    drive = shutil.copytree(DRIVE, folder / "covered")
    for path in (drive / covered / "data").iterdir():
        dark = np.full(cv2.imread(str(path)).shape, 12, np.uint8)
        assert cv2.imwrite(str(path), dark)
    return drive


def _removed_by(drive: Path, sample_settings: Settings, before: AnalysedDrive) -> int:
    """How many of the cones that `before` put on the map a drive, which finds none, takes from it."""
    features = [
        delta.new.model_copy(update={"last_seen_ns": 1, "first_seen_ns": 0})
        for delta in reconcile(before.tracks, [], lambda *_: None, ReconcileContext(PARAMS.reconcile, "first"))
        if delta.new is not None
    ]
    assert len(features) >= 8
    # Poses as they are logged: odometry has nothing to go by.
    trajectory = PARAMS.trajectory.model_copy(update={"refine": False})
    params = PARAMS.model_copy(update={"trajectory": trajectory})
    dark_drive = analyse_folder(drive, sample_settings, params)
    assert dark_drive.tracks == []
    evidence = read_model_card(None).evidence
    assert evidence is not None
    figures = AbsenceFigures(evidence=evidence, score_threshold=params.detection.score_threshold)
    dark = dark_drive.records
    view = observations_of_drive(dark.drive.rig, dark.drive.frame_pairs, dark.detections, [], figures)
    check = partial(check_visibility, drive=view, params=params.reconcile)
    deltas = reconcile([], features, check, ReconcileContext(params.reconcile, "second"))
    return sum(delta.kind is DeltaKind.REMOVED for delta in deltas)
