"""Steps that refine poses and calibration: visual odometry, self-calibration, and one adjustment of the whole trajectory."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from conetl.files.parquet_store import has_result, load_result, load_results, result_key, result_path, save_result
from conetl.geometry.linear_reference import evenly_spaced
from conetl.geometry.motion.rolling_shutter import points_at_stamp, rate_of, readout_sigma_s, stamp_sigma_s
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.motion.stereo_tracks import (
    StereoTracks,
    cameras_of,
    expected_motions,
    motions_between,
    motions_of,
    shifts_between,
)
from conetl.model.arrays import Image
from conetl.model.check_params import CheckParams, ImageCheckParams
from conetl.model.drive import Drive, FramePair
from conetl.model.health import Finding
from conetl.model.params import IngestParams, TrajectoryParams, params_sha256
from conetl.model.rejections import Rejection
from conetl.model.rig import Rig, Side
from conetl.perception import visual_odometry
from conetl.perception.checks.stereo_check import check_lost_parts
from conetl.perception.checks.torn_images import check_torn, find_torn
from conetl.perception.rectified_image import fetch_pairs, read_pair_image
from conetl.perception.visual_odometry import follow_drive
from conetl.perception.worker_setup import set_up_worker
from conetl.perception.working_size import ImageReader
from conetl.pipeline.chunks import ANALYSIS_VERSION, Chunk, geometry_key, load_matches, parts_of
from conetl.pipeline.executor import Tick, step
from conetl.tracking.checks.exposures import check_lost_frames, check_recording, right_camera_ahead
from conetl.tracking.checks.poses import check_trajectory
from conetl.tracking.control_points import refine_with_control
from conetl.tracking.rolling_shutter import matches_at_stamp
from conetl.tracking.self_calibration import SelfCalibration, Span, choose_spans, span_params
from conetl.tracking.self_calibration import self_calibrate as estimate_calibration
from conetl.tracking.trajectory import RefinedTrajectory, is_by_course
from conetl.tracking.upright_edges import with_roll

_log = logging.getLogger(__name__)
_PAIRS_AT_ONCE = 8
#: Neighbouring spans share an image, which is read once; a step costs Prefect as much as two spans.
_SPANS_OF_PIECE = 20


def track_motions(chunk: Chunk, part: int, rig: Rig, read: ImageReader, tick: Tick) -> Iterator[None]:
    """Motions of one part of a chunk, also to the first frame pair after it.

    Each step reads one more pair by `read`; the last step stores the motions. rig: of the drive after its self-calibration. tick:
    called for every motion.
    """
    own, params = _part(chunk, part), chunk.params.trajectory
    key = _motions_key(own, rig)
    if has_result(chunk.results_folder, key):
        tick(len(own.frame_pairs) - 1)
        return
    set_up_worker()
    yield  # the first motion needs two pairs
    found: list[RelativeMotion] = []
    followed = follow_drive(own.frame_pairs, own.rig, _prefetching(read, own.frame_pairs), params)
    for motion in motions_of(followed, own.frame_pairs, rig, params):
        found.append(motion)
        tick(1)
        yield
    save_result(chunk.results_folder, key, found, [])


def motions_path(chunk: Chunk, part: int, rig: Rig) -> Path:
    """The Parquet file of the motions that `track_motions` stores."""
    return result_path(chunk.results_folder, _motions_key(_part(chunk, part), rig))


def _part(chunk: Chunk, part: int) -> Chunk:
    """One part of a chunk and the first frame pair after it, so that no interval is lost between parts."""
    within = parts_of(chunk)[part]
    pairs = chunk.frame_pairs[within.start : within.stop + 1]
    if within.stop == len(chunk.frame_pairs) and chunk.next_pair is not None:
        pairs += (chunk.next_pair,)
    return chunk.model_copy(update={"frame_pairs": pairs})


def _motions_key(own: Chunk, rig: Rig) -> str:
    params = params_sha256(own.params.trajectory)
    return result_key(ANALYSIS_VERSION, "motions", params, geometry_key(own), rig.model_dump_json())


def calibration_pieces(chunk: Chunk, pairs: Sequence[FramePair]) -> list[Chunk]:
    """Pieces of a drive, as chunks, for self-calibration: all of its spans, or evenly spaced ones.

    chunk: any of the drive's; pairs: all of the drive's.
    """
    params = chunk.params.trajectory
    spans, most = _spans(chunk.rig, pairs, params), params.self_calibration_max_spans
    length = min(_SPANS_OF_PIECE, most)
    starts = list(range(0, len(spans), length))
    if len(spans) > most:
        starts = np.linspace(0, len(spans) - length, most // length).round().astype(int).tolist()
    runs = [spans[start : start + length] for start in starts]
    return [chunk.model_copy(update={"frame_pairs": tuple(pairs[run[0].first : run[-1].last + 1])}) for run in runs]


@step("follow points", "follow points {piece.frames}")
def follow_spans(piece: Chunk) -> Path:
    """Follow points over the spans of one of the `calibration_pieces`; returns the Parquet file."""
    params, pairs, rig = piece.params.trajectory, piece.frame_pairs, piece.rig
    key = result_key(ANALYSIS_VERSION, "spans", params_sha256(params), geometry_key(piece))
    if has_result(piece.results_folder, key):
        return result_path(piece.results_folder, key)
    set_up_worker()
    spans = _spans(rig, pairs, params)
    return save_result(piece.results_folder, key, list(_followed(spans, pairs, rig, params)), [])


@step("self-calibrate", "self-calibrate {chunk.drive_id}")
def self_calibrate(chunk: Chunk, pieces: Sequence[Chunk], followed: Sequence[Path]) -> SelfCalibration:
    """Self-calibration from the points of all pieces. chunk: any of the drive's; followed: one file per piece."""
    params, folder, rig = chunk.params.trajectory, chunk.results_folder, chunk.rig
    key = result_key(ANALYSIS_VERSION, "self-calibration", *(path.stem for path in followed))
    if has_result(folder, key):
        return load_result(result_path(folder, key), SelfCalibration)[0][0]
    spans = [span for piece in pieces for span in _spans(rig, piece.frame_pairs, params)]
    speeds = [speed for piece in pieces for speed in _speeds(_spans(rig, piece.frame_pairs, params), piece.frame_pairs)]
    found = _calibration(rig, spans, speeds, load_results(followed, StereoTracks)[0], params)
    save_result(folder, key, [found], [])
    _log.info("Self-calibration: %s", found.detail)
    return found


def calibrate_drive(drive: Drive, params: TrajectoryParams) -> SelfCalibration:
    """Self-calibration of a drive in one thread."""
    pairs, rig = drive.frame_pairs, drive.rig
    spans = evenly_spaced(_spans(rig, pairs, params), params.self_calibration_max_spans)
    return _calibration(rig, spans, _speeds(spans, pairs), list(_followed(spans, pairs, rig, params)), params)


def _speeds(spans: Sequence[Span], pairs: Sequence[FramePair]) -> list[float]:
    """Mean speed of each span, m/s."""
    seconds = [1e-9 * (pairs[span.last].captured_at_ns - pairs[span.first].captured_at_ns) for span in spans]
    lengths_m = [float(np.linalg.norm(span.last_SE3_first[:3, 3])) for span in spans]
    return [length_m / max(lasts_s, 1e-3) for length_m, lasts_s in zip(lengths_m, seconds, strict=True)]


def _spans(rig: Rig, pairs: Sequence[FramePair], params: TrajectoryParams) -> list[Span]:
    steps_s = np.diff([pair.captured_at_ns for pair in pairs]) * 1e-9
    return list(choose_spans(expected_motions(pairs, rig), params.self_calibration_span_m, steps_s.tolist()))


def _followed(
    spans: Sequence[Span], pairs: Sequence[FramePair], rig: Rig, params: TrajectoryParams
) -> Iterator[StereoTracks]:
    read = grey_reader(rig, [pairs[k] for k in sorted({end for span in spans for end in span[:2]})])
    return visual_odometry.follow_spans((span[:3] for span in spans), pairs, rig, read, span_params(params))


def _calibration(
    rig: Rig,
    spans: Sequence[Span],
    speeds_m_s: Sequence[float],
    tracks: Sequence[StereoTracks],
    params: TrajectoryParams,
) -> SelfCalibration:
    found = estimate_calibration(rig, spans, tracks, params)
    cameras = cameras_of(rig)
    points = [
        (points_at_stamp(rig, cameras, each.points()[0], rate_of(span.last_SE3_first, span.lasts_s)), speed)
        for span, each, speed in zip(spans, tracks, speeds_m_s, strict=True)
        if each.missing is None
    ]
    ahead = right_camera_ahead(cameras, [one for one, _ in points], [speed for _, speed in points])
    return found.model_copy(update={"right_ahead": ahead})


@step("refine", "refine {drive.drive_id}")
def refine(
    drive: Drive, motions: Sequence[RelativeMotion], matches: list[Path], params: IngestParams
) -> RefinedTrajectory:
    """Refined poses of the whole drive, or the logged ones with the reason if images or parameters do not allow it."""
    pairs = drive.frame_pairs
    found = matches_at_stamp(load_matches(matches, pairs)[0], pairs, drive.rig)
    params = params.model_copy(update={"trajectory": params_of_drive(drive, params.trajectory)})
    if is_by_course(pairs):
        pairs = with_roll(pairs, drive.rig, motions, grey_reader(drive.rig), params.trajectory)
    result = refine_with_control(pairs, drive.rig, motions, found, params, drive.control_points)
    _log.info("Trajectory %s: %s", result.outcome.replace("_", " "), result.detail)
    return result


@step("follow points across lost pairs", "follow points across lost pairs {drive.drive_id}")
def motions_across(drive: Drive, motions: Sequence[RelativeMotion], params: TrajectoryParams) -> list[RelativeMotion]:
    """Motions between neighbouring frame pairs that have none, because those between them could not be decoded."""
    pairs, rig, found = drive.frame_pairs, drive.rig, []
    read = grey_reader(rig)
    for both, motion in zip(pairwise(pairs), motions_between(pairs, motions), strict=True):
        if motion is None:
            [across] = motions_of(follow_drive(both, rig, read, params), both, rig, params)
            found.append(across.model_copy(update={"row_changes": ()}))  # those are compared from frame to frame
    return found


def torn_pairs(
    drive: Drive, motions: Sequence[RelativeMotion], params: ImageCheckParams
) -> tuple[Finding, list[Rejection]]:
    """How many frame pairs have a torn image; rejections of these pairs."""
    return check_torn(find_torn(drive, motions, grey_reader(drive.rig.rectified_from or drive.rig), params), drive)


def check_poses(
    drive: Drive,
    motions: Sequence[RelativeMotion],
    trajectory: RefinedTrajectory,
    params: TrajectoryParams,
    limits: CheckParams,
) -> list[Finding]:
    """The logged poses against the images. drive: with the detail of its images (`FramePair.detail`)."""
    details = {pair.frame_index: pair.detail for pair in drive.frame_pairs}
    pairs = [pair.model_copy(update={"detail": details[pair.frame_index]}) for pair in trajectory.logged]
    findings = check_trajectory(pairs, drive.rig, motions, trajectory, params_of_drive(drive, params), limits)
    if motions and len(pairs) > 1:
        read = grey_reader(drive.rig)
        findings += [
            check(pairs, drive.rig, motions, read, params, limits.exposures)
            for check in (check_lost_frames, check_recording)
        ]
        lost = np.isnan(shifts_between(pairs, motions)[:, 0]).tolist()
        findings += check_lost_parts(drive.model_copy(update={"frame_pairs": tuple(pairs)}), lost, limits.stereo)
    return findings if trajectory.control is None else [*findings, trajectory.control]


def params_of_drive(drive: Drive, params: TrajectoryParams) -> TrajectoryParams:
    """The parameters with the sigma of the drive's own clocks, if known, and what is not known of its shutters: the row that time
    stamps belong to, and the readout, which changes measured distances."""
    clock_s = params.clock_sigma_s if drive.clock_sigma_s is None else drive.clock_sigma_s
    scale = params.readout_scale_per_s * readout_sigma_s(drive.rig)
    return params.model_copy(
        update={
            "clock_sigma_s": float(np.hypot(clock_s, stamp_sigma_s(drive.rig))),
            "scale_sigma": float(np.hypot(params.scale_sigma, scale)),
        }
    )


def grey_reader(rig: Rig, in_order: Sequence[FramePair] = ()) -> ImageReader:
    """Reads the grey images of a drive's frame pairs; images of pairs that are read in order are prefetched."""
    return _prefetching(lambda pair, side: read_pair_image(pair, side, rig, grey=True), in_order)


def _prefetching(read: ImageReader, in_order: Sequence[FramePair]) -> ImageReader:
    """As `read`; images of frame pairs that are read in order are prefetched."""
    batches = {
        in_order[k].frame_index: in_order[k : k + _PAIRS_AT_ONCE] for k in range(0, len(in_order), _PAIRS_AT_ONCE)
    }

    def fetched(pair: FramePair, side: Side) -> Image:
        if side == "left":
            fetch_pairs(batches.get(pair.frame_index, ()))
        return read(pair, side)

    return fetched
