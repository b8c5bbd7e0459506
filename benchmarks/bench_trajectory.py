"""Refined against logged trajectory: how still the cones of a drive stand, and what the refinement costs.

Each cone's frames are cut into four parts by time, and each part alone gives a place (joint
adjustment of its rays). The distance of two cones is then taken for all 4 x 4 pairs of parts: where the trajectory holds, all are
equal.

    python benchmarks/bench_trajectory.py DRIVE [--cache FILE] [--self-calibrate]
"""

from __future__ import annotations

import argparse
import itertools
import pickle
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from conetl.geometry.joint_fit import fit_point
from conetl.geometry.motion.stereo_tracks import motions_of
from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.model.records import Drive, FramePair, Position, StereoMatch
from conetl.perception.detections import check_boxes
from conetl.perception.detector import detect_image, load_detector
from conetl.perception.images import read_image
from conetl.perception.visual_odometry import follow_drive
from conetl.pipeline.odometry import calibrate_drive
from conetl.readers.drives import read_drive
from conetl.tracking.error_propagation import pose_cov
from conetl.tracking.landmarks import refine_with_cones
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


def places(pairs: list[FramePair], drive: Drive, matches: list[StereoMatch], params: IngestParams) -> list[Position]:
    return locate_positions(matches, {p.frame_index: p for p in pairs}, drive.rig, params.position)[0]


def part_places(
    group: list[Position], found: dict[tuple[int, int], StereoMatch], drive: Drive, poses: dict[int, FramePair]
) -> np.ndarray:
    """(PARTS, 3) place of one cone from each part of its frames, by the product's own joint adjustment."""
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
            np.array([rig.left.fx_px, rig.left.fy_px, rig.right.fx_px, rig.right.fy_px]),
            np.array([rig.left.cx_px, rig.left.cy_px, rig.right.cx_px, rig.right.cy_px]),
            sigma_u_px=np.array([m.sigma_u_px for m in pairs]),
            sigma_v_px=np.array([m.sigma_v_px for m in pairs]),
            sigma_pointing_px=np.array([m.sigma_pointing_px for m in pairs]),
            sigma_motion_m=np.full(len(pairs), 0.02),
        )
        if fit is None:
            raise SystemExit(f"no place from frame pairs {[p.frame_index for p in some]}")
        result.append(fit.xyz_m)
    return np.array(result)


def report(name: str, pairs: list[FramePair], drive: Drive, groups: list, matches: list, params: IngestParams) -> None:
    positions = {(p.frame_index, p.match_index): p for p in places(pairs, drive, matches, params)}
    poses, found = {p.frame_index: p for p in pairs}, {(m.frame_index, m.match_index): m for m in matches}
    feet = [part_places([positions[m] for m in members if m in positions], found, drive, poses) for members in groups]
    slides = [float(np.linalg.norm(f[:, None, :2] - f[None, :, :2], axis=2).max()) for f in feet]
    rows = []
    for a, b in itertools.combinations(range(len(feet)), 2):
        d = np.linalg.norm(feet[a][:, None, :2] - feet[b][None, :, :2], axis=2).ravel()
        rows.append((float(d.std(ddof=1)), float(np.ptp(d) / 2)))
    table = np.array(rows)
    print(f"{name:28s} cone moves between parts by up to {max(slides):.3f} m; distance of two cones: "
          f"std median {np.median(table[:, 0]):.3f}, worst {table[:, 0].max():.3f} m; "
          f"half range median {np.median(table[:, 1]):.3f}, worst {table[:, 1].max():.3f} m")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("drive", type=Path)
    parser.add_argument("--cache", type=Path, help="keep detections here between runs (pickle)")
    parser.add_argument("--self-calibrate", action="store_true", help="turn the right camera as the drive asks for")
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
    refined = list(by_motion.frame_pairs)
    with_cones = refine_with_cones(logged, drive.rig, motions, matches, params)
    last = list(with_cones.frame_pairs)
    found = [box for pair in boxes.values() for side in pair for box in side]
    cones, _ = fuse_tracks(places(last, drive, matches, params), matches, found, last, drive.rig, params)
    errors = pose_cov(with_cones, params.trajectory)
    variances = estimate_variance_factors(cones, matches, drive.rig, {p.frame_index: p.pose for p in last}, errors)
    print("variances over stated ones: " + ", ".join(f"{k} {v:.2f}" for k, v in variances._asdict().items()))
    matches = with_variance_factors(matches, variances)
    groups = [cone.members for cone in cones]
    print(f"{len(cones)} cones, seen in {[len(g) for g in groups]} frame pairs; {with_cones.detail}")
    report("as logged", logged, drive, groups, matches, params)
    report("visual odometry", refined, drive, groups, matches, params)
    report("visual odometry and cones", last, drive, groups, matches, params)
    off = refine_trajectory(logged, drive.rig, motions, TrajectoryParams(refine=False))
    report("refine: false", list(off.frame_pairs), drive, groups, matches, params)


if __name__ == "__main__":
    main()
