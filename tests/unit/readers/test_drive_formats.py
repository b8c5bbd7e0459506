"""Conformance: one recording in every format gives the same drive, and the same faults cost the same pairs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from conetl.geometry import pose as se3
from conetl.geometry import rig as rigs
from conetl.model.drive import Drive
from conetl.model.errors import DriveFolderError
from conetl.model.rejections import Rejection
from conetl.model.rejections import RejectionReason as R
from conetl.pipeline.entries import Entry, find_entries
from conetl.readers.drives import FORMATS, find_format, read_drive
from conetl.readers.drives.header import read_header
from conetl.readers.rigs import write_rig_yaml
from tests.unit.readers.drive_formats import (
    WRITERS,
    Frame,
    T,
    changed,
    georeference,
    header,
    packed_bag,
    sample_frames,
    sample_rig,
    write_bag,
    write_euroc,
    write_ros1_bag,
)

OTHERS = [name for name in WRITERS if name != "kitti"]
#: Other samples are bags.
FORMAT_OF = {"kitti": "kitti", "plain": "plain", "euroc": "euroc"}
#: A video changes its images: `test_video_drives.py` has tests of its own.
ELSEWHERE = {"video"}


FRAMES, RIG = sample_frames(), sample_rig()


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return read_drive(WRITERS["kitti"](tmp_path_factory.mktemp("reference") / "run", FRAMES, RIG))[0]


def read(path: Path) -> tuple[Drive, list[Rejection]]:
    return read_drive(path, images_folder=path.parent / "cache")


def test_every_format_is_tested() -> None:
    tested = {FORMAT_OF.get(name, "bag") for name in WRITERS} | ELSEWHERE
    assert tested == {found.NAME for found in FORMATS}


@pytest.mark.parametrize("name", OTHERS)
def test_every_format_gives_the_same_drive(name: str, tmp_path: Path, reference: Drive) -> None:
    path = WRITERS[name](tmp_path / "run", FRAMES, RIG)
    assert FORMAT_OF.get(name, "bag") == find_format(path).NAME
    drive, rejections = read(path)
    assert rejections == []
    assert (drive.drive_id, drive.map_srid, drive.expected_frame_count) == ("run", reference.map_srid, len(FRAMES))
    assert drive.rig.baseline_m == pytest.approx(reference.rig.baseline_m, rel=1e-4)
    assert (drive.rig.left.width_px, drive.rig.left.height_px) == (RIG.left.width_px, RIG.left.height_px)
    assert drive.rig.left.fx_px == pytest.approx(RIG.left.fx_px, rel=1e-5)
    assert len(drive.frame_pairs) == len(reference.frame_pairs)
    for pair, wanted in zip(drive.frame_pairs, reference.frame_pairs, strict=True):
        assert (pair.frame_index, pair.captured_at_ns) == (wanted.frame_index, wanted.captured_at_ns)
        assert Path(pair.left_path).read_bytes() == Path(wanted.left_path).read_bytes()
        assert Path(pair.right_path).read_bytes() == Path(wanted.right_path).read_bytes()
        # Bodies may be other FRAMES; where the cameras are in the map must not depend on the format.
        for found, true in (
            (rigs.map_SE3_left(pair.pose, drive.rig), rigs.map_SE3_left(wanted.pose, reference.rig)),
            (
                rigs.map_SE3_camera(pair.pose, drive.rig, "right"),
                rigs.map_SE3_camera(wanted.pose, reference.rig, "right"),
            ),
        ):
            np.testing.assert_allclose(found[:3, 3], true[:3, 3], atol=1e-3, rtol=0)
            np.testing.assert_allclose(found[:3, :3], true[:3, :3], atol=2e-4)
        np.testing.assert_allclose(pair.pose.sigma_enu_m, wanted.pose.sigma_enu_m)
        np.testing.assert_allclose(pair.pose.sigma_rpy_rad, wanted.pose.sigma_rpy_rad)
        # x forward, z up, whatever the axes of the sensor are called
        np.testing.assert_allclose(pair.pose.map_R_body, wanted.pose.map_R_body, atol=2e-4)
    again = read(path)[0]
    assert again.content_sha256 == drive.content_sha256
    other = WRITERS[name](tmp_path / "other" / "run", changed(FRAMES, 4, left=FRAMES[5].left), RIG)
    assert read(other)[0].content_sha256 != drive.content_sha256


def small_image() -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((20, 30, 3), 9, np.uint8))[1].tobytes())


def without_poses(frames: list[Frame]) -> list[Frame]:
    for i in range(2, 8):
        frames = changed(frames, i, oxts=None)
    return frames


FAULTS: dict[str, tuple[Callable[[list[Frame]], list[Frame]], dict[int, R]]] = {
    "right image missing": (lambda f: changed(f, 3, right=None), {3: R.IMAGE_MISSING}),
    "left image missing": (lambda f: changed(f, 0, left=None), {0: R.IMAGE_MISSING}),
    "image cut off": (lambda f: changed(f, 4, left=(f[4].left or b"")[:-500]), {4: R.IMAGE_TRUNCATED}),
    "no image at all": (lambda f: changed(f, 2, right=b"not an image"), {2: R.IMAGE_UNREADABLE}),
    "another size": (lambda f: changed(f, 5, right=small_image()), {5: R.IMAGE_WRONG_SIZE}),
    "time falls": (lambda f: changed(f, 6, stamp_ns=f[1].stamp_ns - 5 * 10**9), {6: R.TIMESTAMP_INVALID}),
    "clock not set at first": (
        lambda f: changed(f, 0, stamp_ns=5 * 10**9, pose_stamp_ns=5 * 10**9), {0: R.TIMESTAMP_INVALID},
    ),
    "another clock at last": (
        lambda f: changed(f, -1 % len(f), stamp_ns=f[-1].stamp_ns + 400 * 86_400 * 10**9), {9: R.TIMESTAMP_INVALID},
    ),
    "another century": (lambda f: changed(f, 6, stamp_ns=2_100_000_000 * 10**9), {6: R.TIMESTAMP_INVALID}),
    "a flight": (
        lambda f: changed(f, 4, oxts=(*f[4].oxts[:2], 10_000.0, *f[4].oxts[3:]) if f[4].oxts else None), {4: R.POSE_INVALID},
    ),
    "two wild fixes": (
        lambda f: [replace(g, oxts=(g.oxts[0] + 0.01, *g.oxts[1:])) if i in (5, 6) and g.oxts else g for i, g in enumerate(f)],
        {5: R.POSE_INVALID, 6: R.POSE_INVALID},
    ),
    "pose is NaN": (lambda f: changed(f, 4, oxts=(math.nan,) * 30), {4: R.POSE_INVALID}),
    "poses missing": (without_poses, dict.fromkeys(range(2, 8), R.POSE_MISSING)),
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("fault", FAULTS)
def test_the_same_faults_cost_the_same_pairs(name: str, fault: str, tmp_path: Path) -> None:
    damage, lost = FAULTS[fault]
    drive, rejections = read(WRITERS[name](tmp_path / "run", damage(FRAMES), RIG))
    assert Counter(r.reason for r in rejections) == Counter(lost.values())
    kept = [frame.stamp_ns for i, frame in enumerate(FRAMES) if i not in lost]
    assert [pair.captured_at_ns for pair in drive.frame_pairs] == kept
    assert drive.expected_frame_count == len(FRAMES)
    if name != "plain":  # which numbers pairs by the rows of its trajectory
        assert {r.payload["frame_index"] for r in rejections} == set(lost)
    assert all(r.step == "frames" and r.detail for r in rejections)
    if "clock" in fault and "bag" not in name and "mcap" not in name:  # whose times are the recorder's
        found = read_header(tmp_path / "run")
        assert (found.captured_from_ns, found.captured_to_ns) == (kept[0], kept[-1])


def test_a_bag_whose_recorder_had_no_time_at_first_has_the_time_of_its_end(tmp_path: Path) -> None:
    first = changed(FRAMES, 0, stamp_ns=5 * 10**9, pose_stamp_ns=5 * 10**9)
    found = read_header(write_bag(tmp_path / "run", first, RIG, recorder_as_images=True))
    assert (found.problem, found.captured_from_ns) == (None, found.captured_to_ns)
    assert found.captured_to_ns == FRAMES[-1].stamp_ns
    unset = [changed([f], 0, stamp_ns=f.stamp_ns % 10**15, pose_stamp_ns=f.stamp_ns % 10**15)[0] for f in FRAMES]
    found = read_header(write_bag(tmp_path / "unset", unset, RIG))
    assert (found.problem, found.captured_from_ns) == (None, None)


@pytest.mark.parametrize("name", WRITERS)
def test_headers_only_understands_the_same(name: str, tmp_path: Path) -> None:
    damaged = changed(changed(FRAMES, 3, right=None), 4, left=(FRAMES[4].left or b"")[:-500])
    path = WRITERS[name](tmp_path / "run", damaged, RIG)
    full, full_rejections = read(path)
    quick, rejections = read_drive(path, images_folder=tmp_path / "quick", headers_only=True)
    assert rejections == full_rejections
    assert [p.pose for p in quick.frame_pairs] == [p.pose for p in full.frame_pairs]
    assert Path(quick.frame_pairs[0].left_path).is_file()
    assert len([p for p in (tmp_path / "quick").rglob("*") if p.is_file()]) in (0, 2)


# --------------------------------------------------------------------------- what only some formats have


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("euroc", "sigmas: {horizontal_m: 0.02}", r"georeference: \{lon_deg"),
        ("odometry bag", "sigmas: {horizontal_m: 0.02}", r"georeference: \{lon_deg"),
        ("euroc", "GEOREFERENCE", r"sigmas\.horizontal_m"),
        ("euroc", "GEOREFERENCEsigmas: {horizontal_m: 0.02}\nstreams: {left: cam1, right: cam0}", "swapped"),
        ("bag", "streams: {trajectory: /nothing}", "no topic /nothing; found /gnss/fix"),
        ("bag", "streams: {trajectory: /imu/data}", "expected sensor_msgs/msg/NavSatFix"),
        ("bag", "streams: {left: /stereo/right/image_raw/compressed, right: /stereo/left/image_raw/compressed}", "swapped"),
        ("bag", "pair_tolerance_ms: 1e308", r"pair_tolerance_ms.*at most 60000"),
        ("bag", "antenna_t_m: [40, -20, 110]", r"antenna_t_m.*at most 20"),
        ("bag", "max_pose_gap_s: 1e308", r"max_pose_gap_s.*at most 3600"),
    ],
)  # fmt: skip
def test_a_drive_yaml_that_does_not_fit_is_refused(name: str, text: str, message: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "run", FRAMES[:3], RIG)
    (path / "drive.yaml").write_text(text.replace("GEOREFERENCE", georeference(FRAMES)))
    with pytest.raises(DriveFolderError, match=message) as refused:
        read(path)
    assert len(str(refused.value)) < 1000


def test_a_euroc_lens_makes_a_raw_rig(tmp_path: Path) -> None:
    path = write_euroc(tmp_path / "run", FRAMES, RIG)
    for cam in ("cam0", "cam1"):
        file = path / f"mav0/{cam}/sensor.yaml"
        sensor = yaml.safe_load(file.read_text()) | {"distortion_coefficients": [-0.2, 0.05, 1e-4, 2e-4]}
        file.write_text(yaml.safe_dump(sensor))
    raw = read(path)[0].rig.rectified_from
    assert raw is not None
    assert (raw.left.lens.model, raw.left.lens.coefficients[:4]) == ("brown", (-0.2, 0.05, 1e-4, 2e-4))


def raw_image(stamp_ns: int, frame_id: str, data: bytes) -> tuple[str, Any]:
    image = cv2.cvtColor(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    height, width = image.shape[:2]
    step = 3 * width + 6  # rows may be padded
    rows = np.zeros((height, step), np.uint8)
    rows[:, : 3 * width] = image.reshape(height, -1)
    kind = "sensor_msgs/msg/Image"
    return kind, T[kind](
        header=header(stamp_ns, frame_id), height=height, width=width, encoding="rgb8", is_bigendian=0, step=step,
        data=rows.reshape(-1),
    )  # fmt: skip


@pytest.mark.parametrize("write", [write_bag, write_ros1_bag])
def test_raw_images_of_a_bag_lose_nothing(write: Callable[..., Path], tmp_path: Path) -> None:
    few = FRAMES[:3]
    path = write(tmp_path / "run", few, RIG, image=raw_image, image_name="image_raw")
    drive, rejections = read(path)
    assert rejections == []
    for pair, frame in zip(drive.frame_pairs, few, strict=True):
        true = cv2.imdecode(np.frombuffer(frame.left or b"", np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(cv2.imread(pair.left_path), true)


def test_images_of_a_bag_are_unpacked_once(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", FRAMES[:3], RIG)
    read(path)
    files = {p: p.stat().st_ino for p in (tmp_path / "cache").rglob("*.jpg")}
    assert len(files) == 6
    read(path)
    assert {p: p.stat().st_ino for p in (tmp_path / "cache").rglob("*") if p.is_file()} == files


@pytest.mark.parametrize(("late_ms", "kept"), [(4, 3), (6, 2)])
def test_pairs_are_made_within_the_tolerance(late_ms: int, kept: int, tmp_path: Path) -> None:
    path = write_euroc(tmp_path / "run", FRAMES[:3], RIG)
    stamp = FRAMES[1].stamp_ns
    change_rows(path, str(stamp), str(stamp + late_ms * 10**6), ("cam1",))
    drive, rejections = read(path)
    assert len(drive.frame_pairs) == kept
    # each of the two that found no partner is one rejection
    assert [r.reason for r in rejections] == [R.IMAGE_MISSING] * (2 if kept == 2 else 0)
    assert all("5 ms" in r.detail for r in rejections)


@pytest.mark.parametrize("name", ["euroc", "odometry bag"])
@pytest.mark.parametrize(("every", "marked"), [(1, False), (4, True), (5, False)])
def test_sparse_records_of_any_format_are_interpolated_alike(
    name: str, every: int, marked: bool, tmp_path: Path
) -> None:
    """By a spline, whose poses are marked: those between two records do not count as measurements of their own."""
    some = [f if i % every == 0 else replace(f, oxts=None) for i, f in enumerate(FRAMES)]
    drive, rejections = read(WRITERS[name](tmp_path / "run", some, RIG))
    last = (len(FRAMES) - 1) // every * every
    assert [r.reason for r in rejections] == [R.POSE_MISSING] * (len(FRAMES) - 1 - last)
    assert {pair.pose.interpolated is not None for pair in drive.frame_pairs} == {marked}


def test_a_bag_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    file = WRITERS["mcap file"](tmp_path / "run", FRAMES[:3], RIG)
    file.write_bytes(file.read_bytes()[:-20_000])
    with pytest.raises(DriveFolderError, match="mcap recover"):
        read(file)


@pytest.mark.parametrize("write", [write_bag, write_ros1_bag], ids=["folder", "bare file"])
def test_a_bag_requires_the_poses_of_cameras_and_antenna(write: Callable[..., Path], tmp_path: Path) -> None:
    path = write(tmp_path / "run", FRAMES[:3], RIG, connected=False)
    rig = small_file_of(path, "rig.yaml")
    with pytest.raises(DriveFolderError, match=f"put a {rig.name} with body_SE3_left"):
        read(path)
    write_rig_yaml(RIG, rig)
    with pytest.raises(DriveFolderError, match="antenna_t_m"):
        read(path)
    small_file_of(path, "drive.yaml").write_text("antenna_t_m: [0.4, -0.2, 1.1]\n")
    drive, rejections = read(path)
    assert (len(drive.frame_pairs), rejections) == (3, [])


@pytest.mark.parametrize(
    ("topic", "lost"),
    [
        ("/stereo/left/image_raw/compressed", [R.TIMESTAMP_INVALID]),
        ("/stereo/right/image_raw/compressed", [R.IMAGE_MISSING]),
        ("/gnss/fix", []),  # interpolated between its neighbours
        ("/imu/data", []),
    ],
)
def test_a_damaged_message_costs_itself(topic: str, lost: list[R], tmp_path: Path) -> None:
    def mangle(name: str, number: int, data: bytes) -> bytes:
        return data[:10] if (name, number) == (topic, 3) else data

    path = write_bag(tmp_path / "run", FRAMES, RIG, mangle=mangle)
    drive, rejections = read(path)
    assert [r.reason for r in rejections] == lost
    assert [r.payload["frame_index"] for r in rejections] == [3] * len(lost)
    assert (len(drive.frame_pairs), drive.expected_frame_count) == (10 - len(lost), 10)


def test_an_unpacked_image_that_was_damaged_is_unpacked_again(tmp_path: Path) -> None:
    """As a power failure leaves it: of the right size, without content."""
    path = write_bag(tmp_path / "run", FRAMES, RIG)
    pair = read(path)[0].frame_pairs[0]
    unpacked = Path(pair.left_path)
    unpacked.write_bytes(bytes(unpacked.stat().st_size))
    assert read(path)[0].frame_pairs[0] == pair
    assert unpacked.read_bytes() == FRAMES[0].left


def costs_one(path: Path, number: int, reason: R, words: str) -> None:
    """Reading a drive of ten frame pairs rejects one of them."""
    drive, rejections = read(path)
    assert [(r.reason, r.payload["frame_index"]) for r in rejections] == [(reason, number)]
    assert words in rejections[0].detail
    assert len(drive.frame_pairs) == 9


def test_stamps_that_no_driver_set_cost_their_pairs(tmp_path: Path) -> None:
    costs_one(write_bag(tmp_path / "run", changed(FRAMES, 4, stamp_ns=0), RIG), 4, R.TIMESTAMP_INVALID, "stamp is zero")


def change_rows(path: Path, old: str, new: str, cameras: tuple[str, ...] = ("cam0",)) -> None:
    for cam in cameras:
        file = path / f"mav0/{cam}/data.csv"
        file.write_text(file.read_text().replace(old, new))


def test_a_euroc_row_without_a_time_costs_one_pair(tmp_path: Path) -> None:
    path = write_euroc(tmp_path / "run", FRAMES, RIG)
    change_rows(path, f"{FRAMES[5].stamp_ns},", "soon,", ("cam0", "cam1"))
    costs_one(path, 5, R.TIMESTAMP_INVALID, "'soon' is not a time stamp")


def test_a_euroc_row_must_stay_inside_the_drive(tmp_path: Path) -> None:
    path = write_euroc(tmp_path / "run", FRAMES, RIG)
    (tmp_path / "outside.jpg").write_bytes(FRAMES[1].left or b"")
    change_rows(path, "000001.jpg", "../../../../outside.jpg")
    costs_one(path, 1, R.IMAGE_MISSING, "not a file name inside the drive folder")


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_has_a_header(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "day" / "run", FRAMES, RIG)
    if path.is_dir():
        assert find_entries(tmp_path) == [Entry(path)]
    found = read_header(path)
    assert (found.problem, found.drive_id, found.frame_pairs) == (None, "run", len(FRAMES))
    assert (found.captured_from_ns, found.captured_to_ns) == (FRAMES[0].stamp_ns, FRAMES[-1].stamp_ns)
    assert read_header(path).header_sha256 == found.header_sha256
    shorter = WRITERS[name](tmp_path / "other" / "run", FRAMES[:-1], RIG)
    assert read_header(shorter).header_sha256 != found.header_sha256


def small_file_of(path: Path, name: str) -> Path:
    """Where drive.yaml or rig.yaml of a drive belongs: in its folder, or beside a bare bag under its name."""
    return path.with_name(f"{path.stem}.{name}") if path.is_file() else path / name


@pytest.mark.parametrize("name", WRITERS)
def test_header_and_reader_use_the_same_drive_yaml(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "day" / "run", FRAMES, RIG)
    before = read_header(path).header_sha256
    (path.parent / "drive.yaml").write_text("drive_id: of-somebody-else\n")
    assert read_header(path).header_sha256 == before
    settings = small_file_of(path, "drive.yaml")
    settings.write_text((settings.read_text() if settings.is_file() else "") + "drive_id: morning\n")
    whole, _ = read(path)
    found = read_header(path)
    assert found.drive_id == whole.drive_id == "morning"
    assert found.header_sha256 != before
    settings.write_text("no_such_key: 1\n")
    with pytest.raises(DriveFolderError) as refusal:
        read(path)
    assert read_header(path).problem == str(refusal.value)


@pytest.mark.parametrize("name", ["kitti", "plain", "euroc"])
def test_corrected_poses_are_another_header(name: str, tmp_path: Path) -> None:
    """Post-processing moves the poses and nothing else."""
    before, corrected = (FRAMES, [replace(f, oxts=(f.oxts[0] + 5e-6, *f.oxts[1:])) for f in FRAMES if f.oxts])
    first, then = (
        read_header(WRITERS[name](tmp_path / part / "run", made, RIG)).header_sha256
        for part, made in (("before", before), ("after", corrected))
    )
    assert first != then


@pytest.mark.parametrize(
    ("name", "late"),
    [
        ("kitti", "oxts"),
        ("kitti", "image_03"),
        ("kitti", "image_02/timestamps.txt"),
        ("plain", "trajectory.csv"),
        ("euroc", "mav0/state_groundtruth_estimate0"),
        ("euroc", "mav0/state_groundtruth_estimate0/data.csv"),
        ("euroc", "mav0/cam1/data.csv"),
    ],
)
def test_missing_files_are_the_problem_until_they_arrive(name: str, late: str, tmp_path: Path) -> None:
    """Trajectories are computed later than images are copied. What was refused without one is another delivery with it."""
    path = WRITERS[name](tmp_path / "run", FRAMES, RIG)
    (path / late).rename(tmp_path / "late")
    with pytest.raises(DriveFolderError) as refusal:
        read_drive(path, headers_only=True)
    before = read_header(path)
    assert before.problem is not None
    assert str(refusal.value).startswith(before.problem)
    (tmp_path / "late").rename(path / late)
    after = read_header(path)
    assert after.problem is None
    assert after.header_sha256 != before.header_sha256


def test_another_rig_beside_a_bare_bag_is_another_drive(tmp_path: Path) -> None:
    path = WRITERS["mcap file"](tmp_path / "run", FRAMES[:2], RIG)
    before = read_header(path).header_sha256
    write_rig_yaml(RIG, small_file_of(path, "rig.yaml"))
    assert read_header(path).header_sha256 != before


@pytest.mark.parametrize("name", WRITERS)
def test_a_link_to_a_drive_of_any_format_is_that_drive(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "run", FRAMES[:2], RIG)
    link = tmp_path / f"linked{path.suffix}"
    link.symlink_to(path)
    direct, linked = read_header(path), read_header(link)
    assert linked.problem is None
    assert (linked.drive_id, linked.header_sha256) == (direct.drive_id, direct.header_sha256)
    assert read(link)[0].drive_id == direct.drive_id


OUTSIDE = {"upwards": "../../elsewhere/cam0", "absolute": "{elsewhere}/cam0", "by a link": "linked"}


@pytest.mark.parametrize("kind", OUTSIDE)
@pytest.mark.parametrize("stream", ["left", "right", "trajectory"])
def test_paths_outside_of_a_euroc_drive_are_rejected(kind: str, stream: str, tmp_path: Path) -> None:
    (write_euroc(tmp_path / "other", FRAMES[:3], RIG) / "mav0").rename(tmp_path / "elsewhere")
    path = write_euroc(tmp_path / "run", FRAMES[:3], RIG)
    (path / "mav0" / "linked").symlink_to(tmp_path / "elsewhere" / "cam0")
    named = OUTSIDE[kind].format(elsewhere=tmp_path / "elsewhere")
    with (path / "drive.yaml").open("a") as file:
        file.write(f"streams: {{{stream}: {named}}}\n")
    with pytest.raises(DriveFolderError, match=f"'{named}' is outside the drive folder") as refusal:
        read(path)
    assert read_header(path).problem == str(refusal.value)


@pytest.mark.parametrize("name", ["../front", "{path}/front"])
def test_a_camera_may_be_anywhere_inside_of_a_euroc_drive(name: str, tmp_path: Path) -> None:
    path = write_euroc(tmp_path / "run", FRAMES[:3], RIG)
    (path / "mav0" / "cam0").rename(path / "front")
    with (path / "drive.yaml").open("a") as file:
        file.write(f"streams: {{left: {name.format(path=path)}}}\n")
    drive, _ = read(path)
    found = read_header(path)
    assert (found.problem, found.frame_pairs, len(drive.frame_pairs)) == (None, 3, 3)


def test_a_named_kitti_camera_must_not_be_a_link_to_the_outside(tmp_path: Path) -> None:
    path = WRITERS["kitti"](tmp_path / "run", FRAMES[:3], RIG)
    (path / "image_02").rename(tmp_path / "elsewhere")
    (path / "image_02").symlink_to(tmp_path / "elsewhere")
    assert read_header(path).problem is None
    read(path)  # where nothing is named, links are the user's own layout
    (path / "drive.yaml").write_text("cameras: {left: image_02}\n")
    with pytest.raises(DriveFolderError, match="is outside the drive folder") as refusal:
        read(path)
    assert read_header(path).problem == str(refusal.value)


def test_a_bag_whose_metadata_is_a_bomb_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", FRAMES, RIG)
    bomb = "\n".join(f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9) if n else 'x'}]" for n in range(10))
    (path / "metadata.yaml").write_text(bomb)
    with pytest.raises(DriveFolderError, match="each alias counts"):
        read(path)


def compressed_chunks(path: Path, compression: CompressionType, extra: bytes) -> None:
    """Rewrite an MCAP file as one compressed chunk, with another message in it."""
    with path.open("rb") as file:
        messages = list(make_reader(file).iter_messages())
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=1 << 30, compression=compression)
        writer.start(profile="ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in messages:
            assert schema is not None
            if channel.id not in channels:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        last = messages[-1][2]
        writer.add_message(channels[last.channel_id], last.log_time, extra, last.publish_time)
        writer.finish()


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("name", ["bag", "mcap file"])
def test_a_chunk_that_grows_beyond_the_limit_is_refused(
    name: str, compression: CompressionType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = WRITERS[name](tmp_path / "run", FRAMES[:3], RIG)
    file = path if path.is_file() else next(path.glob("*.mcap"))
    compressed_chunks(file, compression, b"")
    assert len(read(path)[0].frame_pairs) == 3
    data = file.read_bytes()
    at = data.index(bytes([6]), data.index(b"ros2"))  # the chunk, after the header
    file.write_bytes(data[: at + 25] + (2**40).to_bytes(8, "little") + data[at + 33 :])  # the size that it states
    assert len(read(path)[0].frame_pairs) == 3, "nobody allocates it"
    monkeypatch.setattr("conetl.readers.drives.bags.messages.MAX_CHUNK_BYTES", 8 << 20)
    file.write_bytes(data)
    compressed_chunks(file, compression, bytes(9 << 20))
    with pytest.raises(DriveFolderError, match=f"{path.name}: .* larger than 8 MB"):
        read(path)


def test_topics_beyond_all_bounds_are_named_in_short(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", FRAMES[:3], RIG, image_name="right" + 300 * "9")
    with pytest.raises(DriveFolderError, match="topics of the left and the right camera are unknown") as refused:
        read(path)
    assert len(str(refused.value)) < 1000


def test_a_lever_arm_that_tf_static_makes_too_long_is_refused(tmp_path: Path) -> None:
    far = RIG.model_copy(
        update={f"body_SE3_{side}": moved(rigs.body_SE3_camera(RIG, side)) for side in ("left", "right")}
    )
    path = write_bag(tmp_path / "run", FRAMES[:3], far)
    with pytest.raises(DriveFolderError, match=r"the lever arm of body_SE3_left is .* expected at most 20 m"):
        read(path)


def moved(pose: Any) -> Any:
    return se3.to_matrix4(se3.se3(np.eye(3), [500.0, 0.0, 0.0]) @ pose)


@pytest.mark.parametrize("name", ["bag", "mcap file", "odometry bag"])
def test_a_type_with_other_fields_is_not_the_type(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "run", FRAMES[:3], RIG)
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix in (".mcap", ".db3"))
    old, new = (b"float64[9] k", b"float64[9] q")  # the same number of bytes in all definitions of CameraInfo
    assert old in file.read_bytes()
    file.write_bytes(file.read_bytes().replace(old, new))
    with pytest.raises(DriveFolderError, match=r"CameraInfo|bag cannot be read"):
        read(path)


def test_a_bag_whose_files_are_compressed_as_a_whole_grows_within_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = packed_bag(tmp_path, FRAMES[:3], RIG)
    assert read_header(path).frame_pairs == 3
    monkeypatch.setattr("conetl.readers.drives.bags.messages.MAX_GROWTH", 0.5)
    with pytest.raises(DriveFolderError, match="unpacked, its files need more than the free space"):
        read(path)


@pytest.mark.parametrize(
    "row", ["9" * 5000 + ",a.jpg", "1772366401000000000," + "a" * 300, "1772366401000000000,a\0.jpg"]
)
def test_rows_of_a_euroc_folder_that_name_no_file_cost_their_pair(row: str, tmp_path: Path) -> None:
    path = write_euroc(tmp_path / "run", FRAMES, RIG)
    with (path / "mav0/cam0/data.csv").open("a") as file:
        file.write(row + "\n")
    drive, rejections = read(path)
    assert (len(drive.frame_pairs), len(rejections)) == (len(FRAMES), 1)
    assert len(rejections[0].detail) < 500


def test_control_characters_of_a_stamp_are_printed_as_codes(tmp_path: Path) -> None:
    root = write_euroc(tmp_path, sample_frames(), sample_rig())
    path = root / "mav0/cam0/data.csv"
    name, first, *others = path.read_text().splitlines()
    path.write_text("\n".join([name, f"\x1b[31m{first}", *others]))
    assert any(r"'\x1b[31m" in rejection.detail for rejection in read_drive(root, headers_only=True)[1])
