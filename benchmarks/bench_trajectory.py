"""Refined against logged trajectory: consistency of the cones of a drive, and cost of the refinement.

The frames of each cone are divided into four parts by time, and each part gives a position (joint adjustment of its rays). The
distance between two cones is then computed for all 4 x 4 pairs of parts; with a perfect trajectory all are equal.

    python benchmarks/bench_trajectory.py DRIVE [--cache FILE] [--self-calibrate]
"""

from __future__ import annotations

import itertools
import pickle
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.geometry.intersection import fit_point
from conetl.geometry.motion.stereo_tracks import motions_of
from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.model.feature_classes import CONE
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.model.records import Drive, FramePair, Position, StereoMatch
from conetl.perception.detections import check_boxes
from conetl.perception.detector import detect_image, load_detector
from conetl.perception.images import read_image
from conetl.perception.visual_odometry import follow_drive
from conetl.pipeline.odometry import calibrate_drive
from conetl.readers.drives import read_drive
from conetl.tracking.drive_refinement import refine_with_cones
from conetl.tracking.error_propagation import pose_cov
from conetl.tracking.matching.matches import match_pair, with_measured_spread
from conetl.tracking.positions import locate_positions
from conetl.tracking.self_calibration import self_calibrated_rig
from conetl.tracking.tracks import fuse_tracks
from conetl.tracking.trajectory import refine_trajectory
from conetl.tracking.variance_components import estimate_variance_factors, with_variance_factors

PARTS = 4


def read_side(pair: FramePair, side: str) -> np.ndarray:
    return read_image(Path(pair.left_path if side == "left" else pair.right_path))


def find_boxes(drive: Drive, params: IngestParams) -> dict[int, tuple[list, list]]:
    """Detections of a whole drive by frame index, left and right."""
    detector = load_detector(None, threads=1)
    detections = {}
    for pair in drive.frame_pairs:
        images = read_side(pair, "left"), read_side(pair, "right")
        sides = []
        for side, image in zip(("left", "right"), images, strict=True):
            boxes = detect_image(
                detector, image, score_threshold=params.detection.score_threshold, nms_iou=params.detection.nms_iou
            )
            sides.append(check_boxes(boxes, frame_index=pair.frame_index, side=side, params=params.detection)[0])
        detections[pair.frame_index] = (sides[0], sides[1])
    return detections


def match_boxes(drive: Drive, boxes: dict[int, tuple[list, list]], params: IngestParams) -> list[StereoMatch]:
    matches = []
    for pair in drive.frame_pairs:
        left, right = boxes[pair.frame_index]
        if left and right:
            images = read_side(pair, "left"), read_side(pair, "right")
            up = map_SE3_left(pair.pose, drive.rig)[2, :3]
            matches += match_pair(left, right, drive.rig, params.match, up_left=up, images=images)[0]
    return with_measured_spread(matches)


def locate(pairs: list[FramePair], drive: Drive, matches: list[StereoMatch], params: IngestParams) -> list[Position]:
    return locate_positions(matches, {p.frame_index: p for p in pairs}, drive.rig, params.position)[0]


def part_positions(
    group: list[Position], found: dict[tuple[int, int], StereoMatch], drive: Drive, poses: dict[int, FramePair]
) -> np.ndarray:
    """(PARTS, 3) position of one cone from each part of its frames, by the joint adjustment of conetl."""
    rig, result = drive.rig, []
    for part in np.array_split(np.arange(len(group)), PARTS):
        some = [group[i] for i in part]
        pairs = [found[p.frame_index, p.match_index] for p in some]
        body = [poses[p.frame_index].pose for p in some]
        fit = fit_point(
            np.array([(*m.foot_left_uv_px, *m.foot_right_uv_px) for m in pairs]),
            np.array(min(some, key=lambda p: p.range_m).xyz_m),
            np.stack([map_SE3_left(pose, rig) for pose in body]),
            np.stack([map_SE3_right(pose, rig) for pose in body]),
            rig,
            sigma_u_px=np.array([m.sigma_u_px for m in pairs]),
            sigma_v_px=np.array([m.sigma_v_px for m in pairs]),
            sigma_pointing_px=np.array([m.sigma_pointing_px for m in pairs]),
            sigma_motion_m=np.full(len(pairs), 0.02),
        )
        if fit is None:
            raise SystemExit(f"no position from frame pairs {[p.frame_index for p in some]}")
        result.append(fit.xyz_m)
    return np.array(result)


def report(
    name: str, pairs: list[FramePair], drive: Drive, groups: list, matches: list, params: IngestParams
) -> dict[str, object]:
    positions = {(p.frame_index, p.match_index): p for p in locate(pairs, drive, matches, params)}
    poses, found = {p.frame_index: p for p in pairs}, {(m.frame_index, m.match_index): m for m in matches}
    feet = [
        part_positions([positions[m] for m in members if m in positions], found, drive, poses) for members in groups
    ]
    shifts = [float(np.linalg.norm(f[:, None, :2] - f[None, :, :2], axis=2).max()) for f in feet]
    distances = np.array(
        [np.linalg.norm(a[:, None, :2] - b[None, :, :2], axis=2).ravel() for a, b in itertools.combinations(feet, 2)]
    )
    std, half_range = distances.std(axis=1, ddof=1), np.ptp(distances, axis=1) / 2
    return {
        "trajectory": name, "largest shift of a cone m": max(shifts), "distances: std median m": float(np.median(std)),
        "worst m": float(std.max()), "half range median m": float(np.median(half_range)), "worst": float(half_range.max()),
    }  # fmt: skip


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("drive", type=Path)
    parser.add_argument("--cache", type=Path, help="keep detections here between runs (pickle)")
    parser.add_argument("--self-calibrate", action="store_true", help="correct the right camera by self-calibration")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    params = IngestParams()
    drive, _ = read_drive(args.drive)
    if args.cache and args.cache.is_file():
        boxes = pickle.loads(args.cache.read_bytes())
    else:
        boxes = find_boxes(drive, params)
        if args.cache:
            args.cache.write_bytes(pickle.dumps(boxes))
    logged = list(drive.frame_pairs)
    wall, cpu = time.perf_counter(), time.process_time()
    tracks = list(follow_drive(logged, drive.rig, read_side, params.trajectory))
    motions = list(motions_of(tracks, logged, drive.rig, params.trajectory))
    done_wall, done_cpu = time.perf_counter(), time.process_time()
    if args.self_calibrate:
        started = time.perf_counter()
        found = calibrate_drive(drive, params.trajectory, tracks)
        print(f"self-calibration {time.perf_counter() - started:.1f} s wall: {found.detail}")
        drive = drive.model_copy(update={"rig": self_calibrated_rig(drive.rig, found, params.trajectory)})
        motions = list(motions_of(tracks, logged, drive.rig, params.trajectory, motions))
    matches = match_boxes(drive, boxes, params)
    wall_before = time.perf_counter()
    by_motion = refine_trajectory(logged, drive.rig, motions, params.trajectory)
    print(f"{len(logged)} frame pairs: visual odometry {done_wall - wall:.1f} s wall, {done_cpu - cpu:.1f} s CPU (one thread); "
          f"adjustment {time.perf_counter() - wall_before:.2f} s")  # fmt: skip
    print(f"{by_motion.outcome}: {by_motion.detail}")
    with_cones = refine_with_cones(logged, drive.rig, motions, matches, params)
    last = list(with_cones.frame_pairs)
    found = [box for pair in boxes.values() for side in pair for box in side]
    cones, _ = fuse_tracks(locate(last, drive, matches, params), matches, found, last, drive.rig, params)
    errors = pose_cov(with_cones, params.trajectory)
    variances = estimate_variance_factors(cones, matches, drive.rig, {p.frame_index: p.pose for p in last}, errors)
    print("variances over stated ones: " + ", ".join(f"{k} {v:.2f}" for k, v in variances[CONE]._asdict().items()))
    matches = with_variance_factors(matches, variances)
    groups = [cone.members for cone in cones]
    print(f"{len(cones)} cones, seen in {[len(g) for g in groups]} frame pairs; {with_cones.detail}")
    off = refine_trajectory(logged, drive.rig, motions, TrajectoryParams(refine=False))
    rows = [
        report(name, pairs, drive, groups, matches, params)
        for name, pairs in (
            ("as logged", logged),
            ("visual odometry", list(by_motion.frame_pairs)),
            ("visual odometry and cones", last),
            ("refine: false", list(off.frame_pairs)),
        )
    ]
    print_rows("", rows)
    write_json(args.json, rows)


if __name__ == "__main__":
    main()
