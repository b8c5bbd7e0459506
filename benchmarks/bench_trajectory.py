"""Refined against logged trajectory: consistency of the cones of a drive, and cost of the refinement.

The frames of each cone are divided into four parts by time, and each part gives a position (joint adjustment of its rays). The
distance between two cones is then computed for all 4 x 4 pairs of parts; with a perfect trajectory all are equal.

    python benchmarks/bench_trajectory.py DRIVE [--self-calibrate]
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import arguments_of, print_rows, write_json
from conetl.geometry.intersection import fit_point
from conetl.geometry.motion.stereo_tracks import motions_of
from conetl.geometry.rig import map_SE3_camera, map_SE3_left
from conetl.model.drive import Drive, FramePair, Position, StereoMatch
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.perception.images import read_image
from conetl.perception.visual_odometry import follow_drive
from conetl.pipeline.analysis import analyse
from conetl.readers.drives import read_drive
from conetl.tracking.positions import locate_positions
from conetl.tracking.trajectory import refine_trajectory

PARTS = 4


def read_side(pair: FramePair, side: str) -> np.ndarray:
    return read_image(Path(pair.left_path if side == "left" else pair.right_path))


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
            np.stack([map_SE3_camera(pose, rig, "right") for pose in body]),
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
    name: str,
    pairs: list[FramePair],
    drive: Drive,
    groups: Sequence[Sequence[tuple[int, int]]],
    matches: Sequence[StereoMatch],
    params: IngestParams,
) -> dict[str, object]:
    positions = {
        (p.frame_index, p.match_index): p for p in locate_positions(matches, pairs, drive.rig, params.position)[0]
    }
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
    parser.add_argument("--self-calibrate", action="store_true", help="correct the right camera by self-calibration")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    params = IngestParams(trajectory=TrajectoryParams(self_calibrate=args.self_calibrate))
    given, _ = read_drive(args.drive)
    analysed = analyse(given, params)
    drive, matches, logged = analysed.drive, analysed.records.matches, list(given.frame_pairs)
    wall, cpu = time.perf_counter(), time.process_time()
    tracks = follow_drive(logged, drive.rig, read_side, params.trajectory)
    motions = list(motions_of(tracks, logged, drive.rig, params.trajectory))
    done_wall, done_cpu = time.perf_counter(), time.process_time()
    by_motion = refine_trajectory(logged, drive.rig, motions, params.trajectory)
    print(f"{len(logged)} frame pairs: visual odometry {done_wall - wall:.1f} s wall, {done_cpu - cpu:.1f} s CPU (one thread); "
          f"adjustment {time.perf_counter() - done_wall:.2f} s")  # fmt: skip
    print(f"{by_motion.outcome}: {by_motion.detail}\nself-calibration: {analysed.calibration.detail}")
    groups = [cone.members for cone in analysed.tracks]
    print(f"{len(groups)} cones, seen in {[len(g) for g in groups]} frame pairs; {analysed.trajectory.detail}")
    off = refine_trajectory(logged, drive.rig, motions, TrajectoryParams(refine=False))
    rows = [
        report(name, list(pairs), drive, groups, matches, params)
        for name, pairs in (
            ("as logged", logged),
            ("visual odometry", by_motion.frame_pairs),
            ("visual odometry and cones", drive.frame_pairs),
            ("refine: false", off.frame_pairs),
        )
    ]
    print_rows("", rows)
    write_json(args.json, rows)


if __name__ == "__main__":
    main()
