"""One small recording, written in every format that conetl reads: the ground of the conformance suite."""

from __future__ import annotations

import math
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pyproj import Transformer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.rig import Rig
from conetl.readers.drives import read_drive
from conetl.readers.rigs import write_rig_yaml
from conetl.readers.rigs.ros import write_ros_rig
from tests.folders import SAMPLE

COUNT = 10
HEADING_DEG = 30.0
SIGMAS = "sigmas: {horizontal_m: 0.02, vertical_m: 0.03}\n"
STORE = get_typestore(Stores.ROS2_HUMBLE)
T = STORE.types
STORE1 = get_typestore(Stores.ROS1_NOETIC)
STORE1.register({"tf2_msgs/msg/TFMessage": STORE.fielddefs["tf2_msgs/msg/TFMessage"]})
#: An IMU like EuRoC's: its x axis points up, y right, z forward.
IMU_R_BODY = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
ANTENNA_M = np.array([0.4, -0.2, 1.1])


@dataclass(frozen=True)
class Frame:
    """One frame pair: image files (None: not recorded), time, and pose record (None: not recorded)."""

    left: bytes | None
    right: bytes | None
    stamp_ns: int
    pose_stamp_ns: int
    oxts: tuple[float, ...] | None
    sigmas: tuple[float, ...] = (0.02, 0.02, 0.03, 0.05, 0.05, 0.15)
    """Of the pose in bags: east, north, up (m), roll, pitch, yaw (degrees)."""


@cache
def sample_frames() -> list[Frame]:
    found = []
    stamps = (SAMPLE / "image_02/timestamps.txt").read_text().splitlines()
    for i in range(COUNT):
        left, right = ((SAMPLE / f"image_0{c}/data/{i:010d}.jpg").read_bytes() for c in (2, 3))
        day = datetime.fromisoformat(stamps[i][:19]).replace(tzinfo=UTC)
        stamp = int(day.timestamp()) * 10**9 + int(stamps[i][20:29])
        numbers = tuple(float(w) for w in (SAMPLE / f"oxts/data/{i:010d}.txt").read_text().split())
        found.append(Frame(left, right, stamp, stamp, numbers))
    return found


@cache
def sample_rig() -> Rig:
    return read_drive(SAMPLE, headers_only=True)[0].rig


def changed(frames: list[Frame], index: int, **values: Any) -> list[Frame]:
    return [replace(frame, **values) if i == index else frame for i, frame in enumerate(frames)]


def text_time(stamp_ns: int) -> str:
    day = datetime.fromtimestamp(stamp_ns // 10**9, UTC)
    return f"{day:%Y-%m-%d %H:%M:%S}.{stamp_ns % 10**9:09d}"


# --------------------------------------------------------------------------- folders


def write_kitti(root: Path, frames: list[Frame], rig: Rig) -> Path:
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(SAMPLE / name, root / name)
    for folder in ("image_02/data", "image_03/data", "oxts/data"):
        (root / folder).mkdir(parents=True)
    for i, frame in enumerate(frames):
        for camera, data in (("image_02", frame.left), ("image_03", frame.right)):
            if data is not None:
                (root / camera / f"data/{i:010d}.jpg").write_bytes(data)
        if frame.oxts is not None:
            (root / f"oxts/data/{i:010d}.txt").write_text(" ".join(repr(v) for v in frame.oxts))
    for name in ("image_02", "image_03"):
        (root / name / "timestamps.txt").write_text("".join(text_time(f.stamp_ns) + "\n" for f in frames))
    (root / "oxts/timestamps.txt").write_text("".join(text_time(f.pose_stamp_ns) + "\n" for f in frames))
    return root


def write_plain(root: Path, frames: list[Frame], rig: Rig) -> Path:
    for side in ("left", "right"):
        (root / side).mkdir(parents=True)
    write_rig_yaml(rig, root / "rig.yaml")
    rows = [
        "stem,captured_at,lon_deg,lat_deg,height_m,roll_deg,pitch_deg,yaw_deg,sigma_e_m,sigma_n_m,sigma_u_m,"
        "sigma_roll_deg,sigma_pitch_deg,sigma_yaw_deg"
    ]
    for i, frame in enumerate(frames):
        for side, data in (("left", frame.left), ("right", frame.right)):
            if data is not None:
                (root / side / f"{i:04d}.jpg").write_bytes(data)
        if frame.oxts is not None:
            lat, lon, height = frame.oxts[:3]
            angles = ",".join(repr(math.degrees(a)) for a in frame.oxts[3:6])
            rows.append(
                f"{i:04d},{text_time(frame.stamp_ns)},{lon!r},{lat!r},{height!r},{angles},0.02,0.02,0.03,0.05,0.05,0.15"
            )
    (root / "trajectory.csv").write_text("\n".join(rows) + "\n")
    return root


def local_pose(origin: tuple[float, ...], oxts: tuple[float, ...]) -> np.ndarray:
    """Pose in a level frame at `origin` whose x axis has HEADING_DEG, by PROJ's own topocentric conversion."""
    lat, lon, height = origin[:3]
    to_enu = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        f"+step +proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0={height}"
    )
    place = np.array(to_enu.transform(oxts[1], oxts[0], oxts[2]))
    turn = se3.rotation_from_rpy(0.0, 0.0, -math.radians(90.0 - HEADING_DEG))
    return se3.se3(turn @ se3.rotation_from_rpy(*oxts[3:6]), turn @ place)


def quaternion(rotation: np.ndarray) -> tuple[float, float, float, float]:
    from scipy.spatial.transform import Rotation

    if not np.isfinite(rotation).all():
        return (math.nan,) * 4
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return float(w), float(x), float(y), float(z)


def georeference(frames: list[Frame]) -> str:
    lat, lon, height = origin_of(frames)[:3]
    return f"georeference: {{lon_deg: {lon!r}, lat_deg: {lat!r}, height_m: {height!r}, heading_deg: {HEADING_DEG}}}\n"


def origin_of(frames: list[Frame]) -> tuple[float, ...]:
    return next(f.oxts for f in frames if f.oxts is not None and math.isfinite(f.oxts[0]))


def write_euroc(root: Path, frames: list[Frame], rig: Rig) -> Path:
    for cam, side in (("cam0", "left"), ("cam1", "right")):
        (root / f"mav0/{cam}/data").mkdir(parents=True)
        camera = rigs.camera_of(rig, side)
        imu_SE3_camera = se3.compose(se3.se3(IMU_R_BODY, np.zeros(3)), rigs.body_SE3_camera(rig, side))
        sensor = {
            "sensor_type": "camera", "T_BS": {"cols": 4, "rows": 4, "data": imu_SE3_camera.reshape(-1).tolist()},
            "resolution": [camera.width_px, camera.height_px], "camera_model": "pinhole",
            "intrinsics": [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
            "distortion_model": "radial-tangential", "distortion_coefficients": [0.0, 0.0, 0.0, 0.0],
        }  # fmt: skip
        (root / f"mav0/{cam}/sensor.yaml").write_text(yaml.safe_dump(sensor))
        lines = ["#timestamp [ns],filename"]
        for i, frame in enumerate(frames):
            data = getattr(frame, side)
            if data is not None:
                (root / f"mav0/{cam}/data/{i:06d}.jpg").write_bytes(data)
            lines.append(f"{frame.stamp_ns},{i:06d}.jpg")
        (root / f"mav0/{cam}/data.csv").write_text("\n".join(lines) + "\n")
    truth = root / "mav0/state_groundtruth_estimate0"
    truth.mkdir()
    rows = ["#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"]
    for frame in frames:
        if frame.oxts is not None:
            pose = local_pose(origin_of(frames), frame.oxts)
            values = [*pose[:3, 3], *quaternion(pose[:3, :3] @ IMU_R_BODY.T)]
            rows.append(f"{frame.pose_stamp_ns}," + ",".join(repr(float(v)) for v in values))
    (truth / "data.csv").write_text("\n".join(rows) + "\n")
    (root / "drive.yaml").write_text(georeference(frames) + SIGMAS)
    return root


# --------------------------------------------------------------------------- bags


def header(stamp_ns: int, frame_id: str) -> Any:
    time = T["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=time, frame_id=frame_id)


def camera_infos(rig: Rig, scratch: Path) -> dict[str, Any]:
    """CameraInfo of both sides, through the project's own camera_info files."""
    write_ros_rig(rig, scratch)
    found = {}
    for side in ("left", "right"):
        info = yaml.safe_load((scratch / f"{side}.yaml").read_text())
        roi = T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        found[side] = T["sensor_msgs/msg/CameraInfo"](
            header=header(1, f"{side}_optical"), height=info["image_height"], width=info["image_width"],
            distortion_model=info["distortion_model"], d=np.array(info["distortion_coefficients"]["data"]),
            k=np.array(info["camera_matrix"]["data"]), r=np.array(info["rectification_matrix"]["data"]),
            p=np.array(info["projection_matrix"]["data"]), binning_x=0, binning_y=0, roi=roi,
        )  # fmt: skip
    shutil.rmtree(scratch)
    return found


def transform(parent: str, child: str, pose: np.ndarray) -> Any:
    w, x, y, z = quaternion(pose[:3, :3])
    return T["geometry_msgs/msg/TransformStamped"](
        header=header(1, parent), child_frame_id=child,
        transform=T["geometry_msgs/msg/Transform"](
            translation=T["geometry_msgs/msg/Vector3"](x=pose[0, 3], y=pose[1, 3], z=pose[2, 3]),
            rotation=T["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )  # fmt: skip


def fix_messages(frame: Frame) -> list[tuple[str, str, Any]]:
    """NavSatFix of an antenna off the IMU, and Imu."""
    assert frame.oxts is not None
    lat, lon, height, roll, pitch, yaw = frame.oxts[:6]
    rotation = se3.rotation_from_rpy(roll, pitch, yaw)
    if math.isfinite(lat):
        ahead = Transformer.from_pipeline(
            "+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 "
            f"+lon_0={lon} +lat_0={lat} +h_0={height} +step +inv +proj=cart +ellps=WGS84 "
            "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
        )
        lon, lat, height = ahead.transform(*(rotation @ ANTENNA_M))
    fix = T["sensor_msgs/msg/NavSatFix"](
        header=header(frame.pose_stamp_ns, "antenna"), latitude=lat, longitude=lon, altitude=height,
        status=T["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
        position_covariance=np.diag(np.square(frame.sigmas[:3])).reshape(-1), position_covariance_type=2,
    )  # fmt: skip
    w, x, y, z = quaternion(rotation)
    zero = T["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    sigma = np.radians(frame.sigmas[3:])
    imu = T["sensor_msgs/msg/Imu"](
        header=header(frame.pose_stamp_ns, "imu"), orientation=T["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        orientation_covariance=np.diag(sigma**2).reshape(-1), angular_velocity=zero,
        angular_velocity_covariance=np.zeros(9), linear_acceleration=zero, linear_acceleration_covariance=np.zeros(9),
    )  # fmt: skip
    return [("/gnss/fix", "sensor_msgs/msg/NavSatFix", fix), ("/imu/data", "sensor_msgs/msg/Imu", imu)]


def odometry_messages(origin: tuple[float, ...], frame: Frame) -> list[tuple[str, str, Any]]:
    assert frame.oxts is not None
    pose = local_pose(origin, frame.oxts)
    w, x, y, z = quaternion(pose[:3, :3])
    covariance = np.diag(np.square([*frame.sigmas[:3], *np.radians(frame.sigmas[3:])])).reshape(-1)
    zero = T["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    message = T["nav_msgs/msg/Odometry"](
        header=header(frame.pose_stamp_ns, "odom"), child_frame_id="imu",
        pose=T["geometry_msgs/msg/PoseWithCovariance"](
            pose=T["geometry_msgs/msg/Pose"](
                position=T["geometry_msgs/msg/Point"](x=pose[0, 3], y=pose[1, 3], z=pose[2, 3]),
                orientation=T["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
            ),
            covariance=covariance,
        ),
        twist=T["geometry_msgs/msg/TwistWithCovariance"](
            twist=T["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36)
        ),
    )  # fmt: skip
    return [("/odometry", "nav_msgs/msg/Odometry", message)]


def compressed(stamp_ns: int, frame_id: str, data: bytes) -> tuple[str, Any]:
    kind = "sensor_msgs/msg/CompressedImage"
    return kind, T[kind](header=header(stamp_ns, frame_id), format="jpeg", data=np.frombuffer(data, np.uint8))


Image = Callable[[int, str, bytes], tuple[str, Any]]


def recording(
    root: Path,
    frames: list[Frame],
    rig: Rig,
    *,
    odometry: bool = False,
    image: Image = compressed,
    image_name: str = "image_raw/compressed",
    connected: bool = True,
    recorder_as_images: bool = False,
) -> list[tuple[int, str, str, Any]]:
    """Time of the recorder, topic, type and content of all messages."""
    messages: list[tuple[int, str, str, Any]] = []
    start = frames[0].stamp_ns
    for side, info in camera_infos(rig, root.with_name("infos")).items():
        messages.append((start, f"/stereo/{side}/camera_info", "sensor_msgs/msg/CameraInfo", info))
    body_SE3_left = rigs.body_SE3_camera(rig, "left")
    half = se3.se3(np.eye(3), [0.5, 0.0, 0.2])
    links = [
        transform("base_link" if connected else "elsewhere", "imu", half),
        transform("base_link", "left_optical", half @ body_SE3_left),
        transform("base_link", "antenna", half @ se3.se3(np.eye(3), ANTENNA_M)),
    ]  # fmt: skip
    messages.append((start, "/tf_static", "tf2_msgs/msg/TFMessage", T["tf2_msgs/msg/TFMessage"](transforms=links)))
    for i, frame in enumerate(frames):
        at = frame.stamp_ns if recorder_as_images else start + i * 10**8
        for side in ("left", "right"):
            data = getattr(frame, side)
            if data is not None:
                kind, content = image(frame.stamp_ns, f"{side}_optical", data)
                messages.append((at, f"/stereo/{side}/{image_name}", kind, content))
        if frame.oxts is not None:
            made = odometry_messages(origin_of(frames), frame) if odometry else fix_messages(frame)
            messages += [(at, topic, kind, content) for topic, kind, content in made]
    return messages


def write_bag(
    root: Path,
    frames: list[Frame],
    rig: Rig,
    *,
    plugin: StoragePlugin = StoragePlugin.MCAP,
    packed: bool = False,
    mangle: Callable[[str, int, bytes], bytes] = lambda topic, number, data: data,
    **options: Any,
) -> Path:
    messages = recording(root, frames, rig, **options)
    opened = Writer(root, version=9, storage_plugin=plugin)
    if packed:
        opened.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with opened as writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in dict.fromkeys((m[1], m[2]) for m in messages)
        }
        counts: Counter[str] = Counter()
        for at, topic, kind, content in messages:
            data = mangle(topic, counts[topic], bytes(STORE.serialize_cdr(content, kind)))
            writer.write(topics[topic], at, data)
            counts[topic] += 1
    if options.get("odometry"):
        (root / "drive.yaml").write_text(georeference(frames))
    return root


def packed_bag(root: Path, frames: list[Frame], rig: Rig) -> Path:
    """Files compressed as a whole: .db3.zstd."""
    return write_bag(root / "run", frames, rig, plugin=StoragePlugin.SQLITE3, packed=True)


def as_ros1(content: Any) -> Any:
    """A message of ROS 2 as the same one of ROS 1: a header has a number, a CameraInfo names in capitals."""
    if isinstance(content, list):
        return [as_ros1(item) for item in content]
    if not hasattr(content, "__msgtype__"):
        return content
    names = [name for name, _ in STORE1.fielddefs[content.__msgtype__][1]]
    values = {name: getattr(content, name, getattr(content, name.lower(), 0)) for name in names}
    return STORE1.types[content.__msgtype__](**{name: as_ros1(value) for name, value in values.items()})


def write_ros1_bag(
    root: Path,
    frames: list[Frame],
    rig: Rig,
    *,
    compression: Writer1.CompressionFormat | None = None,
    chunk_bytes: int = 1 << 18,
    **options: Any,
) -> Path:
    file = root.with_suffix(".bag")
    file.parent.mkdir(parents=True, exist_ok=True)
    writer = Writer1(file)
    if compression is not None:
        writer.set_compression(compression)
    writer.chunk_threshold = chunk_bytes
    messages = recording(root, frames, rig, **options)
    with writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=STORE1)
            for topic, kind in dict.fromkeys((m[1], m[2]) for m in messages)
        }
        for at, topic, kind, content in messages:
            writer.write(topics[topic], at, STORE1.serialize_ros1(as_ros1(content), kind))
    return file


def write_odometry_bag(root: Path, frames: list[Frame], rig: Rig) -> Path:
    return write_bag(root, frames, rig, plugin=StoragePlugin.SQLITE3, odometry=True)


def write_mcap_file(root: Path, frames: list[Frame], rig: Rig) -> Path:
    folder = write_bag(root.with_name("folder"), frames, rig)
    file = root.with_suffix(".mcap")
    next(folder.glob("*.mcap")).rename(file)
    shutil.rmtree(folder)
    return file


WRITERS: dict[str, Callable[[Path, list[Frame], Rig], Path]] = {
    "kitti": write_kitti, "plain": write_plain, "euroc": write_euroc, "bag": write_bag,
    "odometry bag": write_odometry_bag, "mcap file": write_mcap_file,
    "ros1 bag": write_ros1_bag,
}  # fmt: skip
