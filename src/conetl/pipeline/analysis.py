"""The workflow of a drive, from its images to its tracks: `analyse` runs the steps in the order of the data flow."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path

from conetl.checks.verdict import judge_all
from conetl.files.parquet_store import load_results
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.mapping.revisits import check_revisits
from conetl.model.detector_evidence import UNMEASURED, DetectorEvidence
from conetl.model.drive import Detection, Drive, DriveRecords, ImageDetail, Position, StereoMatch, Track
from conetl.model.feature_classes import LANE_MARKING, LINE_CLASSES
from conetl.model.health import Finding, HealthCheck
from conetl.model.params import IngestParams, SelectionParams
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import Rig
from conetl.perception.alike_pairs import without_alike
from conetl.perception.checks.stereo_check import check_stereo
from conetl.perception.detections import add_image_detail, drop_unread_pairs
from conetl.perception.model_card import read_model_card
from conetl.perception.video import frame_of
from conetl.pipeline import odometry
from conetl.pipeline.chunks import Chunk, chunks_of, load_matches, parts_of
from conetl.pipeline.detect import Detected, ExtraSteps, detail_path, detect, match
from conetl.pipeline.executor import Executor, Progress, ProgressCount, Submitted, ThreadExecutor, results, step
from conetl.pipeline.markings import mark
from conetl.pipeline.settings import Settings, read_settings
from conetl.tracking.association import MotionError
from conetl.tracking.checks.exposures import check_doubled, check_exposures
from conetl.tracking.checks.poses import check_calibration, check_readout
from conetl.tracking.error_propagation import PoseCov, motion_error, pose_cov
from conetl.tracking.positions import locate_positions
from conetl.tracking.rolling_shutter import matches_at_stamp, with_video_prior
from conetl.tracking.self_calibration import (
    SWITCHED_OFF,
    SelfCalibration,
    self_calibrated_rig,
    widened_by_offset,
    with_measured_scale,
)
from conetl.tracking.standing import without_moving
from conetl.tracking.tracks import drive_data, fuse_tracks
from conetl.tracking.trajectory import RefinedTrajectory
from conetl.tracking.variance_components import estimate_variance_factors, with_contradictions, with_variance_factors

_log = logging.getLogger(__name__)


@dataclass(frozen=True, repr=False)
class AnalysedDrive:
    """The records of every step, with the refined trajectory and calibration."""

    records: DriveRecords
    trajectory: RefinedTrajectory
    calibration: SelfCalibration
    params: IngestParams
    health: tuple[HealthCheck, ...] = ()
    """Checks of the recording."""
    alike: int = 0
    """Number of frame pairs that were left out because they show what others show."""

    def __repr__(self) -> str:
        return f"<AnalysedDrive {self.drive.drive_id}: {len(self.tracks)} tracks; trajectory: {self.trajectory.detail}>"

    @property
    def drive(self) -> Drive:
        """The drive with refined poses and corrected right camera, if trajectory and calibration were refined."""
        return self.records.drive

    @property
    def tracks(self) -> Sequence[Track]:
        """The cones, in the map's CRS, with their covariances."""
        return self.records.tracks

    @property
    def motion(self) -> MotionError | None:
        """Error of the motion between frames; None if the trajectory was not refined."""
        return motion_error(self.trajectory)

    @property
    def poses(self) -> PoseCov:
        """Covariance of the drive's poses, including that between frames."""
        return pose_cov(self.trajectory, self.params.trajectory)


def analyse(
    drive: Drive,
    params: IngestParams | None = None,
    *,
    rejections: Sequence[Rejection] = (),
    settings: Settings | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> AnalysedDrive:
    """Select -> calibrate -> detect -> match -> refine -> locate -> fuse -> validate a drive that was read, without database and
    server.

    drive, rejections: as returned by `read_drive`. settings: model, number of threads, folder for results of finished chunks;
    default: CONETL_* of the environment. executor: runs the steps; default: `settings.workers` threads. progress: called with the
    number of processed images and motions, and of all. Raises ConetlError.
    """
    params, settings = params or IngestParams(), settings or read_settings()
    with ExitStack() as stack:
        executor = executor or stack.enter_context(ThreadExecutor(settings.workers))
        card, extras = read_model_card(settings.model_path), _extra_steps(params)
        card.require_categories(set(params.detection.categories) - set(LINE_CLASSES))

        # Select: leave out frame pairs that show what others show.
        read = len(drive.frame_pairs)
        drive = _without_alike(drive, params.selection)
        alike = read - len(drive.frame_pairs)
        count = ProgressCount(executor, _step_count(drive, extras), progress)

        # Calibrate: the right camera, from points that are followed over pieces of the drive.
        drive, chunks, findings = _chunks(drive, params, settings)
        given = drive.rig
        calibration, rig = _calibrate(drive, chunks[0], executor)

        # Detect and match, chunk by chunk in parallel; the same images give the motions and the points of lane markings.
        parts, matched = _detect_and_match(chunks, rig, extras, executor, count)
        drive = drive.model_copy(update={"rig": rig})
        drive, detections, motions, torn, unread = _whole_pairs(drive, parts, extras, params, executor)

        # Refine: one adjustment of all poses, by motions, matches and what was logged.
        trajectory: RefinedTrajectory = executor.run(odometry.refine, drive, motions, matched, params)
        rig = with_measured_scale(
            rig, given, None if trajectory.path is None else trajectory.path.scale, params.trajectory
        )
        drive = drive.model_copy(update={"frame_pairs": trajectory.frame_pairs, "rig": rig})

        # Locate: a position for every match, by forward intersection.
        positions, unlocated = executor.run(locate, drive, matched, params)
        details, _ = load_results([detail_path(part.detections) for part in parts], ImageDetail)
        drive, without_detail = add_image_detail(drive, details)
        matches, unmatched = load_matches(matched, drive.frame_pairs)
        matches = matches_at_stamp(matches, drive.frame_pairs, drive.rig)

        # Fuse: the positions of an object into a track, the points of a line into a lane marking.
        fused = partial(executor.run, fuse, drive, detections, params, card.evidence, motion_error(trajectory))
        tracks, unfused = fused(matches, positions)
        errors = pose_cov(trajectory, params.trajectory)
        if trajectory.covariance is not None:
            matches, positions, tracks, unlocated, unfused = _weighed(
                drive, matches, tracks, params, errors, fused, executor
            )
        points = [part.marking_points for part in parts if part.marking_points is not None]
        markings = executor.run(mark, drive, points, params.marking, errors) if points else []

    # Validate: does the recording contradict itself?
    rejections = [*rejections, *unread, *without_detail, *unmatched, *unlocated, *unfused]
    records = DriveRecords(drive, detections, matches, positions, tracks, rejections, markings)
    findings += [torn] if extras.odometry else []
    findings += odometry.check_poses(drive, motions, trajectory, params.trajectory, params.check)
    findings += check_readout(calibration, given, params.trajectory)
    findings += _check_records(records, calibration, params)
    return AnalysedDrive(records, trajectory, calibration, params, tuple(judge_all(findings, params.check)), alike)


def _without_alike(drive: Drive, params: SelectionParams) -> Drive:
    """The drive without frame pairs that show what others show. They count neither as read nor as rejected."""
    kept = without_alike(drive.frame_pairs, odometry.grey_reader(drive.rig), params)
    fewer = len(drive.frame_pairs) - len(kept)
    if not fewer:
        return drive
    _log.info("%d of %d frame pairs show what others show and are left out", fewer, len(drive.frame_pairs))
    return drive.model_copy(
        update={"frame_pairs": tuple(kept), "expected_frame_count": drive.expected_frame_count - fewer}
    )


def _step_count(drive: Drive, extras: ExtraSteps) -> int:
    """Number of images and motions."""
    pairs = len(drive.frame_pairs)
    return 2 * pairs + (pairs - 1 if extras.odometry else 0)


def _extra_steps(params: IngestParams) -> ExtraSteps:
    return ExtraSteps(odometry=params.trajectory.refine, markings=LANE_MARKING in params.detection.categories)


def _chunks(drive: Drive, params: IngestParams, settings: Settings) -> tuple[Drive, list[Chunk], list[Finding]]:
    """The drive with the calibration that fits its images, its chunks, and what was found about the calibration."""
    drive = with_video_prior(drive, params.trajectory, is_video=frame_of(drive.frame_pairs[0].left_path) is not None)
    given, chunks = drive.rig, chunks_of(drive, settings, params)
    drive, findings = check_stereo(drive, params.check.stereo)
    if drive.rig != given:  # the calibration is known to be wrong: even small corrections are applied
        small = {"self_calibration_significance": 1.0, "self_calibration_least_px": 0.01}
        trajectory = params.trajectory.model_copy(update=small)
        chunks = chunks_of(drive, settings, params.model_copy(update={"trajectory": trajectory}))
    return drive, chunks, findings


def _whole_pairs(
    drive: Drive, parts: Sequence[Detected], extras: ExtraSteps, params: IngestParams, executor: Executor
) -> tuple[Drive, list[Detection], list[RelativeMotion], Finding, list[Rejection]]:
    """Drive, detections and motions without the frame pairs that could not be decoded or are torn; how many are torn, and
    all rejections."""
    read = len(drive.frame_pairs)
    motions, _ = load_results([part.motions for part in parts if part.motions is not None], RelativeMotion)
    detections, rejected = load_results([part.detections for part in parts], Detection)
    drive, detections = drop_unread_pairs(drive, detections, rejected)
    if extras.odometry and len(drive.frame_pairs) < read:
        motions += executor.run(odometry.motions_across, drive, motions, params.trajectory)
    torn, rejected_pairs = odometry.torn_pairs(drive, motions, params.check.images)
    drive, detections = drop_unread_pairs(drive, detections, rejected_pairs)
    return drive, detections, motions, torn, [*rejected, *rejected_pairs]


def _weighed(
    drive: Drive,
    matches: list[StereoMatch],
    tracks: list[Track],
    params: IngestParams,
    errors: PoseCov,
    fused: Callable[[list[StereoMatch], list[Position]], tuple[list[Track], list[Rejection]]],
    executor: Executor,
) -> tuple[list[StereoMatch], list[Position], list[Track], list[Rejection], list[Rejection]]:
    """Matches, positions and tracks with sigmas estimated from the tracks, and what was rejected of positions and of tracks.

    These tracks have the sigmas of single frame pairs. Their residuals correct the sigmas of each class for the next tracks, and
    the residuals of those the sigmas of single observations.
    """
    weighed, positions, _ = executor.run(estimate_variances, drive, matches, tracks, params, errors)
    tracks, _ = fused(weighed, positions)
    matches, positions, unlocated = executor.run(inflate_outliers, drive, weighed, tracks, params, errors)
    tracks, unfused = fused(matches, positions)
    # Observations of an object that moves contradict each other: sigmas that cover it would hide that.
    tracks, moving = executor.run(reject_moving, drive, weighed, tracks, errors)
    return matches, positions, tracks, unlocated, [*unfused, *moving]


def _check_records(records: DriveRecords, calibration: SelfCalibration, params: IngestParams) -> Iterator[Finding]:
    """What was found about calibration and shutters, and about cones that appear twice: in one image, or at two positions."""
    limits, pairs = params.check.exposures, records.drive.frame_pairs
    yield check_calibration(calibration)
    yield from check_exposures(calibration.right_ahead, records.drive.rig, pairs, limits)
    yield check_doubled(records.tracks, pairs, limits)
    # Where heights jump, the cones of one pass are off the road of the other.
    off_road = (r.payload for r in records.rejections if r.reason is RejectionReason.NOT_ON_GROUND)
    tracks = [*records.tracks, *map(Track.model_validate, off_road)]
    yield from check_revisits(tracks, records.positions, pairs, params)


def _detect_and_match(
    chunks: Sequence[Chunk], rig: Rig, extras: ExtraSteps, executor: Executor, count: ProgressCount
) -> tuple[list[Detected], list[Path]]:
    """Parquet files of the parts of all chunks, in the order of the drive, and of the matches of each chunk.

    extras: what to compute from the images while they are in memory.
    """
    detected = [_detect_parts(chunks[0], rig, extras, executor, count)]
    matched: list[Submitted] = []
    for chunk, following in zip_longest(chunks, chunks[1:]):
        if following is not None:  # in this order, so that matching waits for nothing
            detected.append(_detect_parts(following, rig, extras, executor, count))
        matched.append(executor.submit(match, chunk, rig, *detected[len(matched)]))
    return results([step for steps in detected for step in steps]), results(matched)


def _detect_parts(
    chunk: Chunk, rig: Rig, extras: ExtraSteps, executor: Executor, count: ProgressCount
) -> list[Submitted]:
    """Submit the detections of a chunk, part by part."""
    steps = []
    for part, within in enumerate(parts_of(chunk)):
        steps.append(executor.submit(detect, chunk, part, rig, extras, count.tick))
        pairs = len(chunk.frame_pairs[within])
        is_end = chunk.next_pair is None and within.stop == len(chunk.frame_pairs)
        count.follow(steps[-1], 2 * pairs + (pairs - is_end if extras.odometry else 0))
    return steps


def _calibrate(drive: Drive, chunk: Chunk, executor: Executor) -> tuple[SelfCalibration, Rig]:
    """Self-calibration of a drive, and the corrected rig. chunk: any of the drive's."""
    params, calibration = chunk.params.trajectory, SWITCHED_OFF
    if params.refine and params.self_calibrate:
        pieces = odometry.calibration_pieces(chunk, drive.frame_pairs)
        followed = results([executor.submit(odometry.follow_spans, piece) for piece in pieces])
        calibration = executor.run(odometry.self_calibrate, chunk, pieces, followed)
    return calibration, widened_by_offset(self_calibrated_rig(drive.rig, calibration, params), calibration)


@step("locate", "locate {drive.drive_id}")
def locate(drive: Drive, matches: Sequence[Path], params: IngestParams) -> tuple[list[Position], list[Rejection]]:
    """Positions of a drive by forward intersection. matches: the Parquet file of each chunk, located by itself."""
    pairs, rig = drive.frame_pairs, drive.rig
    found = (matches_at_stamp(load_matches([path], pairs)[0], pairs, rig) for path in matches)
    located = [locate_positions(some, pairs, rig, params.position) for some in found]
    return [one for found, _ in located for one in found], [one for _, rejected in located for one in rejected]


@step("fuse", "fuse {drive.drive_id}")
def fuse(
    drive: Drive,
    detections: list[Detection],
    params: IngestParams,
    evidence: DetectorEvidence | None,
    motion: MotionError | None,
    matches: list[StereoMatch],
    positions: list[Position],
) -> tuple[list[Track], list[Rejection]]:
    """Tracks of the whole drive. evidence: measured response of the model; None if it was not measured.

    motion: error of the motion between frames; None if the trajectory was not refined: then it is a fixed share of the distance.
    """
    data = drive_data(
        drive.frame_pairs, drive.rig, detections, matches, params, evidence or UNMEASURED, motion,
        common_errors=drive.common_errors, corrected=bool(drive.control_points),
    )  # fmt: skip
    return fuse_tracks(positions, data)


@step("estimate variances", "estimate variances {drive.drive_id}")
def estimate_variances(
    drive: Drive, matches: list[StereoMatch], tracks: list[Track], params: IngestParams, errors: PoseCov
) -> tuple[list[StereoMatch], list[Position], list[Rejection]]:
    """Matches of the whole drive with sigmas estimated from its tracks, and their positions; see `estimate_variance_factors`."""
    factors = estimate_variance_factors(drive, matches, tracks, errors)
    weighed = with_variance_factors(matches, factors)
    return weighed, *locate_positions(weighed, drive.frame_pairs, drive.rig, params.position)


@step("inflate outliers", "inflate outliers {drive.drive_id}")
def inflate_outliers(
    drive: Drive, matches: list[StereoMatch], tracks: list[Track], params: IngestParams, errors: PoseCov
) -> tuple[list[StereoMatch], list[Position], list[Rejection]]:
    """Matches of the whole drive with larger sigmas if they contradict their tracks, and positions; see `with_contradictions`."""
    compared = with_contradictions(drive, matches, tracks, errors)
    return compared, *locate_positions(compared, drive.frame_pairs, drive.rig, params.position)


@step("reject moving objects", "reject moving objects {drive.drive_id}")
def reject_moving(
    drive: Drive, matches: list[StereoMatch], tracks: list[Track], errors: PoseCov
) -> tuple[list[Track], list[Rejection]]:
    """The tracks of stationary objects, and rejections of the others; see `without_moving`."""
    return without_moving(drive, matches, tracks, errors)
