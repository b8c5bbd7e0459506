"""What a drive says of its own rig, where no flow runs: visual odometry, spans, self-calibration in one thread."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conetl.geometry.motion.stereo_tracks import StereoTracks, motions_of
from conetl.model.params import TrajectoryParams
from conetl.model.records import Drive, FramePair, Side
from conetl.perception.rectified_image import read_rig_image
from conetl.perception.visual_odometry import follow_drive, follow_span
from conetl.tracking.self_calibration import SelfCalibration, choose_spans, self_calibrate, span_params, spread_spans


def calibrate_drive(
    drive: Drive, params: TrajectoryParams, tracks: list[StereoTracks] | None = None
) -> SelfCalibration:
    """Self-calibration from the images of a drive; tracks: of its intervals, where they are known already."""
    pairs = drive.frame_pairs

    def read(pair: FramePair, side: Side) -> NDArray[np.uint8]:
        return read_rig_image(Path(pair.left_path if side == "left" else pair.right_path), drive.rig, side, grey=True)

    if tracks is None:
        tracks = list(follow_drive(pairs, drive.rig, read, params))
    wide = span_params(params)
    spans = choose_spans(list(motions_of(tracks, pairs, drive.rig, params)), params.self_calibration_span_m)
    spans = spread_spans(spans, params.self_calibration_max_spans)
    points = [follow_span(pairs[s.first], pairs[s.last], s.last_SE3_first, drive.rig, read, wide) for s in spans]
    return self_calibrate(drive.rig, spans, points, params)
