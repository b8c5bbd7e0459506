"""Bags (ROS 2, ROS 1, MCAP) with two cameras and a trajectory. Topics are found by type; drive.yaml (streams) overrides.

    sensor_msgs CompressedImage or Image    two topics, with left and right in their names
    sensor_msgs CameraInfo                  one beside each; or a rig.yaml in the bag's folder, which wins
    sensor_msgs NavSatFix + Imu             WGS 84 position (ellipsoidal height) with its covariance; attitude against east,
                                            north, up (REP 103)
    nav_msgs Odometry                       instead of both: in a level frame that drive.yaml (georeference) locates
    tf2_msgs TFMessage on /tf_static        poses of the left camera and the antenna on the body (the IMU's or odometry's frame)

A bag is a folder with metadata.yaml, a folder with one .mcap or else one .bag, or NAME.mcap or NAME.bag itself (then with
NAME.drive.yaml and NAME.rig.yaml beside it). Times are the header stamps, UTC.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from conetl.files.documents import input_errors
from conetl.geometry import geodesy
from conetl.geometry import pose as se3
from conetl.geometry.geodesy import enu_to_grid
from conetl.geometry.rectification import stored_camera
from conetl.model.arrays import Floats
from conetl.model.drive import Drive, Pose
from conetl.model.errors import InputError
from conetl.model.rejections import Rejection, RejectionReason
from conetl.model.rig import MAX_LEVER_ARM_M, Rig, Side
from conetl.perception.images import ImageFileError, check_image_bytes
from conetl.readers.drives import pairs, poses
from conetl.readers.drives.bags import messages
from conetl.readers.drives.bags.images import VideoDecoder, image_bytes, unpack
from conetl.readers.drives.bags.topics import (
    TF_STATIC,
    TRANSFORMS,
    VIDEO,
    Topics,
    choose_topics,
    is_rectified_topic,
    rig_of_infos,
    transforms_of,
)
from conetl.readers.drives.camera_files import Files, Stream
from conetl.readers.drives.drive_yaml import DriveYaml, small_file
from conetl.readers.drives.formats import HeaderFacts, add_settings, own_rig, rig_on_body
from conetl.readers.drives.sparse_poses import pose_reader, with_course
from conetl.readers.rigs import RIG_YAML
from conetl.readers.trajectories.recorded import MAX_LOCAL_M, RecordedTrajectory, check_fix
from conetl.readers.trajectories.times import clock_problem

#: Time of a record, and its pose (4, 4) with six variances, or what is wrong with it.
_Row = tuple[int, tuple[Floats, Floats] | str]
#: Variances of what a message does not have: a fix no attitude, an attitude no position.
_NONE = np.full(3, np.nan)
NAME, TITLE = "bag", "ROS bag or MCAP"
READS_OBJECTS, UNPACKS = False, True


class _Recorded(NamedTuple):
    """The content of a bag without its images."""

    samples: dict[str, poses.Samples]
    """By topic, as recorded: a fix has degrees and metres in its translation, an attitude no translation."""
    infos: dict[str, Any]
    frame_ids: dict[str, str]
    """By topic; odometry has that of its child. Like all names of frames, they may begin with a slash."""
    transforms: dict[tuple[str, str], Floats]

    def connect(self, dst: str, src: str) -> Floats | None:
        """dst_SE3_src (4, 4) of two frames; None where they are not connected."""
        return se3.find_pose(self.transforms, dst.lstrip("/"), src.lstrip("/"))


def matches(path: Path) -> bool:
    """True for a bag's folder and for a bare .mcap file. (A KITTI drive may hold a bag with other data.)"""
    return messages.bag_files(path) is not None and not (path / "image_02").is_dir()


def read(source: pairs.Source) -> tuple[Drive, list[Rejection]]:
    """The drive and its rejections. Images are unpacked into `images_folder`; with headers_only only the first of each camera."""
    path, root, settings, content = source[:4]
    file = messages.bag_files(root)
    if file is None:
        raise InputError(f"{path}: this is not a bag: neither a .mcap or .bag file nor a folder with metadata.yaml")
    if source.images_folder is None:
        raise InputError(f"{path}: a bag's images must be unpacked, but no folder was given for them")
    add_settings(content, root)
    with messages.open_bag(file) as bag:
        topics = choose_topics(bag.types, settings.streams, path)
        recorded = _read_small(bag, topics, settings, content, path)
        rig, sensor_R_body = _rig(small_file(root, RIG_YAML), topics, recorded, settings, path)
        srid, poses_at = _trajectory(topics, recorded, source, sensor_R_body)
        images = _read_images(bag, topics, rig, content, source.images_folder, root)
    couples = pairs.pair_by_stamp(images[topics.left], images[topics.right], settings.pair_tolerance_ns)
    names: dict[Side, str] = {"left": topics.left, "right": topics.right}
    return pairs.drive_of_couples(couples, names, source, rig, srid, poses_at)


def scan(path: Path, settings: DriveYaml) -> Files:
    """The bag's own metadata, and rig.yaml."""
    del settings
    small = {messages.METADATA: path / messages.METADATA, RIG_YAML: small_file(path, RIG_YAML)}
    return Files(Stream("the left", ()), Stream("the right camera's topic", ()), small)


def read_header(source: pairs.Source, header: HeaderFacts) -> None:
    """Sizes and index of the bag, its number of left images, first and last message by the recorder's clock; no messages."""
    path, root, settings = source[:3]
    file = messages.bag_files(root)  # a linked file by its own name, which is the drive's id
    if file is None:
        raise InputError(f"{path}: this is not a bag")
    for part in [file] if file.is_file() else messages.parts_of(path):
        header.content.add(part.name, str(part.stat().st_size).encode())
    with messages.open_bag(file, index_only=True) as bag:
        topics = choose_topics(bag.types, settings.streams, path)
        header.content.add("index", repr((sorted(bag.counts.items()), bag.recorded_ns)).encode())
        header.frame_pairs = bag.counts[topics.left]
        # If the recorder's clock was set while recording, only the end is known; the images have stamps of their own.
        set_ns = [time_ns for time_ns in bag.recorded_ns if clock_problem(time_ns) is None]
        if set_ns:
            header.first_ns, header.last_ns = set_ns[0], set_ns[-1]


def _stamp_ns(message: messages.Message) -> int | str:
    """Header stamp in UTC nanoseconds, or what is wrong."""
    if message.content is None:
        return f"{message.topic}: the message recorded at {message.recorded_at_ns} ns does not have the content of its type"
    stamp = message.content.header.stamp
    time_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return time_ns if time_ns > 0 else f"{message.topic}: the header stamp is zero: the driver did not set it"


def _read_small(
    bag: messages.Bag, topics: Topics, settings: DriveYaml, content: pairs.ContentHash, source: Path
) -> _Recorded:
    """All messages of the drive except its images. Raises InputError."""
    readers = {topics.trajectory: _odometry if topics.is_local else _fix}
    readers |= {} if topics.imu is None else {topics.imu: _attitude}
    infos = {topic for topic in (topics.left_info, topics.right_info) if topic}
    # Foxglove's recordings have them on any topic.
    known = {topic for topic, kind in bag.types.items() if kind == TRANSFORMS}
    transforms = {TF_STATIC} if TF_STATIC in known else known
    found = _Recorded({}, {}, {}, {})
    rows: dict[str, list[_Row]] = {topic: [] for topic in readers}
    for message in bag.messages([*readers, *infos, *transforms]):
        topic, fields = message.topic, message.content
        if fields is None:
            continue
        if topic in transforms:
            found.transforms.update(transforms_of(fields))
        elif topic in infos:
            if topic not in found.infos:
                found.infos[topic] = fields
                found.frame_ids[topic] = str(fields.header.frame_id)
                content.add(f"info{topic}", np.concatenate([fields.k, fields.d, fields.r, fields.p]).tobytes())
        elif isinstance(stamp := _stamp_ns(message), int):  # else the pairs in a remaining gap are lost
            child = getattr(fields, "child_frame_id", "")
            found.frame_ids.setdefault(topic, str(child or fields.header.frame_id))
            try:
                rows[topic].append((stamp, readers[topic](fields)))
            except ValueError as error:
                rows[topic].append((stamp, str(error)))
    found.samples.update({topic: _samples(topic, read, settings, content, source) for topic, read in rows.items()})
    return found


def _samples(
    topic: str, rows: Sequence[_Row], settings: DriveYaml, content: pairs.ContentHash, source: Path
) -> poses.Samples:
    """The records of a topic, given in the order of their recording. Raises InputError where none can be used."""
    variances = np.array([record[1] for _, record in rows if not isinstance(record, str)]).reshape(-1, 6)
    stated = poses.stated_sigmas(np.sqrt(variances), settings.sigmas)
    sigmas = iter(np.where(np.isnan(variances), 0.0, stated))
    records: dict[int, tuple[Floats, Floats]] = {}
    bad, hashed = {}, bytearray()
    for stamp, record in rows:
        hashed += struct.pack("<q", stamp)
        if isinstance(record, str):
            bad[stamp] = record
        elif np.isnan(sigma := next(sigmas)).any():
            bad[stamp] = poses.NO_SIGMAS
        else:
            records[stamp] = record[0], sigma
            hashed += record[0].tobytes() + sigma.tobytes()
    content.add(f"trajectory{topic}", bytes(hashed))
    if not records:
        raise InputError(f"{source}: {topic}: no usable pose: {next(iter(bad.values()), 'there are none')}")
    times = sorted(records)
    return poses.Samples(
        topic, times, np.array([records[t][0] for t in times]), np.array([records[t][1] for t in times]), bad
    )


def _fix(message: Any) -> tuple[Floats, Floats]:
    """Latitude, longitude, height in the translation; variances. Raises ValueError."""
    if (status := getattr(message, "status", None)) is not None and int(status.status) < 0:
        raise ValueError("the receiver had no fix (status -1)")
    lat, lon, height = float(message.latitude), float(message.longitude), float(message.altitude)
    check_fix(lat, lon, height)
    known = int(message.position_covariance_type) != 0
    variances = _variances(message.position_covariance, (0, 4, 8)) if known else np.zeros(3)
    return se3.se3(np.eye(3), [lat, lon, height]), np.concatenate([variances, _NONE])


def _attitude(message: Any) -> tuple[Floats, Floats]:
    """Rotation against east, north, up (REP 103), and variances. Raises ValueError."""
    if float(message.orientation_covariance[0]) == -1.0:
        raise ValueError("the IMU has no orientation (covariance -1, see sensor_msgs/Imu)")
    q = message.orientation
    rotation = poses.rotation_of(float(q.w), float(q.x), float(q.y), float(q.z))
    variances = _variances(message.orientation_covariance, (0, 4, 8))
    return se3.se3(rotation, np.zeros(3)), np.concatenate([_NONE, variances])


def _odometry(message: Any) -> tuple[Floats, Floats]:
    """Pose in the odometry's own frame, and variances: of x and y the larger, as the frame may be turned. Raises ValueError."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    position = float(p.x), float(p.y), float(p.z)
    if not all(abs(value) < MAX_LOCAL_M for value in position):  # NaN fails too
        raise ValueError(f"expected finite metres below {MAX_LOCAL_M:,.0f}, found {position}")
    variances = _variances(message.pose.covariance, (0, 7, 14, 21, 28, 35))
    variances[:2] = variances[:2].max()
    return se3.se3(poses.rotation_of(float(q.w), float(q.x), float(q.y), float(q.z)), position), variances


def _variances(covariance: Any, diagonal: tuple[int, ...]) -> Floats:
    """Those that are on the diagonal of a covariance; 0 where it states none."""
    return np.fmax(np.asarray(covariance, dtype=np.float64)[[*diagonal]], 0.0)


def _rig(rig_path: Path, topics: Topics, found: _Recorded, settings: DriveYaml, source: Path) -> tuple[Rig, Floats]:
    """The rectified rig and sensor_R_body (3, 3). Raises InputError."""
    given = own_rig(rig_path, settings.pair)
    if given is not None:
        return rig_on_body(*given, settings, rig_path)
    rig = rig_of_infos(topics, found.infos, source)
    sensor = found.frame_ids.get(topics.imu or topics.trajectory, "")
    left_info = topics.left_info or ""
    camera = found.frame_ids[left_info]
    sensor_SE3_left = found.connect(sensor, camera)
    if sensor_SE3_left is None:
        raise InputError(
            f"{source}: {TF_STATIC} does not connect the left camera's frame '{camera}' with '{sensor}', the frame of the "
            f"trajectory; put a {rig_path.name} with body_SE3_left beside the bag"
        )
    if is_rectified_topic(topics.left):
        turn = np.asarray(found.infos[left_info].r, dtype=np.float64).reshape(3, 3)
        sensor_SE3_left = se3.compose(sensor_SE3_left, se3.se3(turn.T, np.zeros(3)))
    return rig_on_body(rig, sensor_SE3_left, settings, source)


def _trajectory(
    topics: Topics, found: _Recorded, source: pairs.Source, sensor_R_body: Floats
) -> tuple[int, pairs.PosesAt]:
    """EPSG code of the map, and the poses of the body in it. Raises InputError."""
    path, gap_ns = source.path, source.settings.max_pose_gap_ns
    raw = found.samples[topics.trajectory]
    if topics.imu is None:
        rotations, positions = (raw.map_SE3_body[:, :3, :3] if topics.is_local else None), raw.map_SE3_body[:, :3, 3]
        times = np.array(raw.times_ns)
        recorded = RecordedTrajectory(raw.name, times, positions, topics.is_local, rotations, raw.sigma, raw.bad)
        srid, track = poses.placed(with_course(recorded), source, sensor_R_body if topics.is_local else np.eye(3))
        max_gap_s = source.settings.max_pose_gap_s
        return srid, partial(pose_reader, track, max_gap_s=max_gap_s, from_course=not topics.is_local)
    antenna_m = _antenna(topics, found, source.settings, path)
    attitude = found.samples[topics.imu]
    lat, lon, height = raw.map_SE3_body[:, :3, 3].T
    srid = poses.checked_srid(source.map_srid, float(lat[0]), float(lon[0]), path)
    with input_errors(path):
        antenna = se3.se3(np.broadcast_to(np.eye(3), (len(lat), 3, 3)), geodesy.to_map(srid, lat, lon, height))
    track = poses.without_wild_fixes(raw._replace(map_SE3_body=antenna))

    def pose_at(time_ns: int) -> Pose:
        fixed, fix_sigma = poses.at(track, time_ns, gap_ns)
        turn, turn_sigma = poses.at(attitude, time_ns, gap_ns)
        lat_deg, lon_deg, _ = geodesy.to_geodetic(srid, fixed[:3, 3])
        map_R_sensor = enu_to_grid(srid, lat_deg, lon_deg, turn[:3, :3])
        body = se3.se3(map_R_sensor @ sensor_R_body, fixed[:3, 3] - map_R_sensor @ antenna_m)
        return se3.to_pose(body, fix_sigma + turn_sigma)

    return srid, lambda _: pose_at


def _antenna(topics: Topics, found: _Recorded, settings: DriveYaml, source: Path) -> Floats:
    """(3,) the antenna in the IMU's frame. Raises InputError."""
    imu, antenna = found.frame_ids.get(topics.imu or "", ""), found.frame_ids.get(topics.trajectory, "")
    if settings.antenna_t_m is not None:
        antenna_m = np.array(settings.antenna_t_m)
    elif (pose := found.connect(imu, antenna)) is not None:
        antenna_m = pose[:3, 3]
    else:
        raise InputError(
            f"{source}: {TF_STATIC} does not connect the antenna '{antenna}' with '{imu}'; put antenna_t_m: [x, y, z] into "
            "drive.yaml ([0, 0, 0] where the receiver's driver reduces its positions to the IMU)"
        )
    if not np.all(np.abs(antenna_m) <= MAX_LEVER_ARM_M):  # NaN fails too
        raise InputError(
            f"{source}: the antenna is at {antenna_m} m in the IMU's frame, expected at most {MAX_LEVER_ARM_M:g} m; put "
            "antenna_t_m: [x, y, z] into drive.yaml"
        )
    return antenna_m


def _read_images(
    bag: messages.Bag, topics: Topics, rig: Rig, content: pairs.ContentHash, folder: Path, source: Path
) -> dict[str, list[pairs.Image]]:
    """Images of both cameras by topic, in the order of recording; one is in memory at a time."""
    sides: dict[str, Side] = {topics.left: "left", topics.right: "right"}
    found: dict[str, list[pairs.Image]] = {topic: [] for topic in sides}
    decoders = {topic: VideoDecoder() for topic in sides if bag.types[topic] == VIDEO}

    def add(topic: str, number: int, data: bytes) -> None:
        """Replace the image of a message by its file."""
        image, camera = found[topic][number], stored_camera(rig, sides[topic])
        path, problem = image.path, None
        try:
            header = check_image_bytes(data, _name_of(topic, image.stamp), (camera.width_px, camera.height_px))
            if not content.headers_only or not any(p.path.is_file() for p in found[topic][:1]):
                path = unpack(data, ".jpg" if header.format == "jpeg" else f".{header.format}", folder)
        except ImageFileError as error:
            problem = pairs.PairError(error.reason, str(error), path=_name_of(topic, image.stamp))
        # An unpacked image is named by its hash.
        sha256 = "" if content.headers_only else path.stem
        found[topic][number] = image._replace(path=path, problem=problem, sha256=sha256)

    for message in bag.messages(list(sides)):
        topic, fields = message.topic, message.content
        number, stamp = len(found[topic]), _stamp_ns(message)
        lost = pairs.PairError(RejectionReason.IMAGE_UNREADABLE, f"{_name_of(topic, stamp)}: there is no image")
        image = pairs.Image(stamp, Path(f"{source}#{topic}@{stamp}"), lost if topic in decoders else None)
        found[topic].append(image)
        if fields is None:
            continue
        try:
            if not content.headers_only:
                content.add(f"{sides[topic]}/{number}", bytes(fields.data))
                content.add(f"{sides[topic]}/{number}/stamp", str(stamp).encode())
            if topic not in decoders:
                add(topic, number, image_bytes(fields, _name_of(topic, stamp)))
                continue
            for decoded, data in () if content.headers_only and number else decoders[topic].decode(number, fields):
                add(topic, decoded, data)
        except pairs.PairError as error:
            found[topic][number] = image._replace(problem=error)
        except ImageFileError as error:
            problem = pairs.PairError(error.reason, str(error), path=_name_of(topic, stamp))
            found[topic][number] = image._replace(problem=problem)
    for topic, decoder in decoders.items():
        with suppress(pairs.PairError, ImageFileError):
            for number, data in decoder.rest():
                add(topic, number, data)
        if content.headers_only:  # the others are not decoded
            found[topic][1:] = [image._replace(problem=None, sha256="") for image in found[topic][1:]]
    return found


def _name_of(topic: str, stamp: int | str) -> str:
    return f"{topic}, image of {stamp} ns" if isinstance(stamp, int) else topic
