"""A rendered drive as a raw rig (lenses, turned cameras) would have taken it: cones come out where the rectified one has them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conetl.checks.verdict import judge_all
from conetl.geometry import camera as cam
from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.geometry.rig import map_SE3_left
from conetl.model.drive import Drive, Position
from conetl.model.health import Verdict
from conetl.model.params import IngestParams
from conetl.model.rig import Camera, Lens, Rig
from conetl.perception.checks.stereo_check import check_stereo
from conetl.perception.detections import to_detections
from conetl.perception.detector import detect_image, load_detector
from conetl.perception.rectified_image import read_rig_image
from conetl.readers.drives import read_drive
from conetl.readers.rigs import read_kitti_rig
from conetl.tracking.matching.matches import match_pair
from conetl.tracking.positions import locate_positions
from tests.folders import SAMPLE

FRAMES = (18, 22, 29, 33)
NEAR_M = 10.5
TURNS = {"left": (0.006, 0.012, -0.007), "right": (-0.008, -0.017, 0.011)}
LENS = {
    "left": Lens(model="brown", coefficients=(-0.28, 0.09, 8e-4, -6e-4, -0.01)),
    "right": Lens(model="brown", coefficients=(-0.26, 0.08, -5e-4, 4e-4, -0.01)),
}
NUMBER = {"left": "02", "right": "03"}


def raw_rig(rectified: Rig) -> Rig:
    """Larger images than the rendered ones, so that these fit into them; the same projection centres."""
    cameras, body = {}, {}
    for side, f in (("left", 690.0), ("right", 684.0)):
        cameras[side] = Camera(
            width_px=1060, height_px=420, fx_px=f, fy_px=f + 2, cx_px=533.0, cy_px=203.0, lens=LENS[side]
        )
        turn = se3.se3(Rotation.from_rotvec(TURNS[side]).as_matrix(), np.zeros(3))
        body[side] = se3.to_matrix4(se3.compose(rigs.body_SE3_camera(rectified, side), turn))  # type: ignore[arg-type]
    return rectified.model_copy(update={
        **cameras, "body_SE3_left": body["left"], "body_SE3_right": body["right"],
    })  # fmt: skip


def raw_view(rectified: Rig, raw: Rig, side: str) -> Callable[[np.ndarray], np.ndarray]:
    """The raw camera's view of rectified images: for each raw pixel its ray, and where the rectified camera sees that."""
    own, theirs = rigs.camera_of(raw, side), rigs.camera_of(rectified, side)  # type: ignore[arg-type]
    u, v = np.meshgrid(np.arange(own.width_px), np.arange(own.height_px))
    rays = cam.rays(own, np.stack([u, v], axis=-1)) @ np.array(Rotation.from_rotvec(TURNS[side]).as_matrix()).T
    assert np.isfinite(rays).all()
    uv = cam.project(theirs, rays).astype(np.float32)
    return lambda image: cv2.remap(image, uv[..., 0], uv[..., 1], cv2.INTER_LANCZOS4, borderValue=(90, 90, 90))


@pytest.fixture(scope="module")
def raw_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample drive in KITTI's "synced only" form: raw images, and the lines of the raw cameras in the calibration."""
    root = tmp_path_factory.mktemp("raw") / "drive"
    for name in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        root.mkdir(exist_ok=True)
        shutil.copy(SAMPLE / name, root)
    shutil.copytree(SAMPLE / "oxts", root / "oxts")
    rectified = read_kitti_rig(SAMPLE / "calib_cam_to_cam.txt", body_required=True)
    raw = raw_rig(rectified)
    lines = dict(line.split(": ", 1) for line in (SAMPLE / "calib_cam_to_cam.txt").read_text().splitlines())
    ideal = read_kitti_rig(SAMPLE / "calib_cam_to_cam.txt", body_required=True, images="raw")
    camera_SE3_cam0 = se3.se3(
        *(np.array(lines[k].split(), dtype=float).reshape(s) for k, s in (("R_02", (3, 3)), ("T_02", 3)))
    )
    body_SE3_cam0 = se3.compose(rigs.body_SE3_camera(ideal, "left"), camera_SE3_cam0)
    for side, number in NUMBER.items():
        camera = rigs.camera_of(raw, side)  # type: ignore[arg-type]
        pose = se3.compose(se3.invert(rigs.body_SE3_camera(raw, side)), body_SE3_cam0)  # type: ignore[arg-type]
        for key, values in (
            ("S", [camera.width_px, camera.height_px]), ("K", cam.matrix_k(camera)), ("D", camera.lens.coefficients),
            ("R", pose[:3, :3]), ("T", pose[:3, 3]),
        ):  # fmt: skip
            lines[f"{key}_{number}"] = " ".join(f"{v:.12e}" for v in np.ravel(values))
        folder = root / f"image_{number}"
        (folder / "data").mkdir(parents=True)
        shutil.copy(SAMPLE / f"image_{number}" / "timestamps.txt", folder)
        taken = raw_view(rectified, raw, side)
        for frame in FRAMES:
            image = cv2.imread(str(SAMPLE / f"image_{number}" / "data" / f"{frame:010d}.jpg"))
            cv2.imwrite(str(folder / "data" / f"{frame:010d}.png"), taken(image))
    (root / "calib_cam_to_cam.txt").write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return root


def positions(drive: Drive) -> list[Position]:
    """Positions of the chosen frames, by detector, matcher and intersection, as `conetl ingest` does it."""
    params, detector = IngestParams(), load_detector(None, threads=1)
    pairs = [pair for pair in drive.frame_pairs if pair.frame_index in FRAMES]
    matches = []
    for pair in pairs:
        found, images = {}, {}
        for side, path in (("left", pair.left_path), ("right", pair.right_path)):
            images[side] = read_rig_image(Path(path), drive.rig, side)  # type: ignore[arg-type]
            boxes = detect_image(
                detector, images[side],
                score_threshold=params.detection.score_threshold, nms_iou=params.detection.nms_iou,
            )  # fmt: skip
            found[side], _ = to_detections(boxes, frame_index=pair.frame_index, side=side, params=params.detection)  # type: ignore[arg-type]
        up = map_SE3_left(pair.pose, drive.rig)[2, :3]
        pair_images = images["left"], images["right"]
        matches += match_pair(
            found["left"], found["right"], drive.rig, params.match, up_left=up, images=pair_images
        )[0]  # fmt: skip
    return locate_positions(matches, pairs, drive.rig, params.position)[0]


@pytest.mark.release
def test_near_cones_stand_where_the_rectified_drive_puts_them(raw_drive: Path) -> None:
    taken, original = read_drive(raw_drive)[0], read_drive(SAMPLE)[0]
    assert taken.rig.rectified_from is not None and original.rig.rectified_from is None
    assert [pair.frame_index for pair in taken.frame_pairs] == list(FRAMES)
    near = [p for p in positions(original) if p.range_m < NEAR_M]
    assert len(near) >= 3, "the sample drive shows a near cone in each of these frames"
    found = positions(taken)
    for position in near:
        same_frame = [p for p in found if p.frame_index == position.frame_index]
        offsets = [np.linalg.norm(np.subtract(p.xyz_m, position.xyz_m)) for p in same_frame]
        print(f"frame {position.frame_index}, {position.range_m:.2f} m: {100 * min(offsets):.2f} cm apart")
        assert min(offsets) < 0.03, "the detector sees the same cone in images that were sampled twice"


def test_raw_images_of_two_lenses_pass_the_health_checks(raw_drive: Path) -> None:
    """Rectified, they differ in width and principal point: points are compared with infinitely far ones."""
    drive = read_drive(raw_drive)[0]
    assert drive.rig.left.width_px != drive.rig.right.width_px
    assert abs(drive.rig.left.cx_px - drive.rig.right.cx_px) > 10.0
    checks = {check.name: check for check in judge_all(check_stereo(drive)[1])}
    failed = {name for name, check in checks.items() if check.verdict is not Verdict.PASS}
    assert failed <= {
        "covered parts of the lenses",
        "blurred parts of the lenses",
    }  # the raw images have a blank margin
    assert checks["columns of the right images"].value is not None
    assert checks["distortion of the lenses"].value is not None
