"""Drives of stereo video with a trajectory file: the same drive as that of images, whatever files and logs it has."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path

import av
import numpy as np
import pytest
import yaml
from click.testing import Result
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.geometry import rig as rigs
from conetl.model.drive import Drive
from conetl.model.errors import ConetlError, DriveFolderError, InputError
from conetl.model.rig import Rig
from conetl.perception.rectified_image import read_pair_image
from conetl.perception.video import index_video, video_facts
from conetl.perception.video_sync import find_video_lag
from conetl.pipeline.analysis import analyse
from conetl.pipeline.settings import Settings
from conetl.readers.drives import find_format, read_drive, video
from conetl.readers.drives.drive_yaml import DriveYaml, Mount, read_drive_yaml, stated
from conetl.readers.drives.header import read_header
from conetl.readers.drives.pairs import Image, pair_by_stamp
from conetl.readers.drives.proposals.template import KEYS, Missing, is_template, template
from conetl.readers.rigs import WRITERS, read_rig_yaml, write_rig_yaml
from conetl.reports.camera_images import ImageMissingError, image_file
from conetl.reports.inspection_images import _middle_pair
from tests import video_drives
from tests.unit.readers.drive_formats import SAMPLE
from tests.unit.readers.trajectory_files import write_csv, write_gpx

X265 = {"crf": "18", "preset": "ultrafast", "x265-params": "log-level=none"}
VIDEOS = {
    "two files": {},
    "side by side": {
        "layout": "right-left", "codec": "libx265", "options": X265, "suffix": ".mkv",
    },
    "motion jpeg": {"layout": "top-bottom", "codec": "mjpeg", "options": {"q:v": "2"}, "suffix": ".mkv"},
}  # fmt: skip


COUNT = 16


@pytest.fixture(scope="module")
def whole() -> Drive:
    return read_drive(SAMPLE)[0]


@pytest.fixture(scope="module")
def sample(whole: Drive) -> Drive:
    return whole.model_copy(update={"frame_pairs": whole.frame_pairs[:COUNT]})


def largest_m(drive: Drive, cones: np.ndarray, home: Path) -> float:
    """Of the distances between the cones of a drive and these, which are as many."""
    found = np.array([t.xyz_m for t in analyse(drive, settings=Settings(home=home / "home", workers=2)).tracks])
    assert len(found) == len(cones)
    return float(np.linalg.norm(found[:, None] - cones, axis=2).min(axis=0).max())


@pytest.fixture(scope="module")
def folder(sample: Drive, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return video_drives.write_video_drive(tmp_path_factory.mktemp("video") / "run", sample)


def copied(folder: Path, tmp_path: Path, *left_out: str, settings: str | None = None) -> Path:
    """The other files, with another drive.yaml or without one."""
    copy = tmp_path / "copy"
    copy.mkdir(parents=True)
    for path in folder.iterdir():
        if path.name not in ("drive.yaml", *left_out):
            (copy / path.name).hardlink_to(path)
    if settings is not None:
        (copy / "drive.yaml").write_text(settings)
    return copy


def init(folder: Path, *words: str) -> Result:
    """`conetl init`; words with a = and without dashes are values of drive.yaml."""
    options = (["--set", word] if "=" in word and not word.startswith("--") else [word] for word in words)
    return CliRunner().invoke(app, ["init", str(folder), *(part for option in options for part in option)])


def missing(made: Result) -> dict[str, str]:
    """What `init` says of each value that is missing, by its key; drive.yaml has a place for each."""
    assert made.exit_code == 1 and "was written, but these values are missing" in made.output, (
        made.output,
        made.exception,
    )
    listed = re.findall(r"^  --(?:set '?([\w.]+)=|(rig) ).*\n      (.*)$", made.output, re.MULTILINE)
    return {key or rig: text for key, rig, text in listed}


def start_of(drive: Drive) -> str:
    return f"{np.datetime64(drive.frame_pairs[0].captured_at_ns, 'ns')}Z".replace("T", " ")


@pytest.mark.parametrize("name", VIDEOS)
def test_videos_give_the_same_drive(name: str, tmp_path: Path, sample: Drive) -> None:
    root = video_drives.write_video_drive(tmp_path / "run", sample, **VIDEOS[name])
    assert find_format(root) is video
    drive, rejections = read_drive(root)
    assert rejections == []
    assert (drive.map_srid, len(drive.frame_pairs)) == (sample.map_srid, len(sample.frame_pairs))
    for pair, wanted in zip(drive.frame_pairs, sample.frame_pairs, strict=True):
        assert abs(pair.captured_at_ns - wanted.captured_at_ns) < 20_000
        np.testing.assert_allclose(
            rigs.map_SE3_left(pair.pose, drive.rig), rigs.map_SE3_left(wanted.pose, sample.rig), atol=1e-3
        )
        np.testing.assert_allclose(pair.pose.sigma_enu_m, wanted.pose.sigma_enu_m)
    for side in ("left", "right"):
        for n in (0, 7, 15):
            found, true = (read_pair_image(d.frame_pairs[n], side, d.rig) for d in (drive, sample))
            assert video_drives.same_image(found, true)
    header = read_header(root)
    assert (header.problem, header.frame_pairs) == (None, COUNT)
    assert header.captured_from_ns == drive.frame_pairs[0].captured_at_ns
    assert read_drive(root)[0].content_sha256 == drive.content_sha256
    assert _middle_pair(drive)[0] == COUNT // 2, "a pair that inspect shows"


@pytest.mark.release
def test_cones_are_where_those_of_the_images_are(whole: Drive, sample_settings: Settings, tmp_path: Path) -> None:
    """Of two files; frames of one file with both images are the same ones."""
    drive = whole.model_copy(update={"frame_pairs": whole.frame_pairs[10:34]})
    cones = np.array([track.xyz_m for track in analyse(drive, settings=sample_settings).tracks])
    folder = video_drives.write_video_drive(tmp_path / "run", drive)
    # On a smooth road what passes by must not be taken for a shift of the files.
    lag = find_video_lag(*(index_video(folder / f"{side}.mp4") for side in ("left", "right")))
    assert lag is None or abs(lag.offset_s) < 0.025
    assert largest_m(read_drive(folder)[0], cones, tmp_path) < 0.015, "half a column between the colours makes 0.01 m"
    log = video_drives.LOGS["RTKLIB .pos"]
    alone = video_drives.with_log(folder, tmp_path / "positions", log, video_drives.known_of(drive))
    assert len(cones) > 6 and largest_m(read_drive(alone)[0], cones, tmp_path) < 0.02, "upright edges show the roll"


@pytest.mark.parametrize("folders", [("image_02", "image_03"), ("left", "right")])
def test_images_with_times_of_their_own(tmp_path: Path, sample: Drive, folders: tuple[str, str]) -> None:
    root = tmp_path / "run"
    root.mkdir()
    left, right = folders
    for camera, folder in zip(("image_02", "image_03"), folders, strict=True):
        (root / folder).mkdir()
        for n, pair in enumerate(sample.frame_pairs):
            (root / folder / f"{pair.captured_at_ns}.jpg").hardlink_to(SAMPLE / camera / f"data/{n:010d}.jpg")
    write_rig_yaml(sample.rig, root / "rig.yaml")
    write_csv(root, video_drives.known_of(sample))
    if left == "left":
        made = init(root)
        assert made.exit_code == 0 and "16 frame pairs" in made.output, made.output
    else:
        (root / "drive.yaml").write_text(f"images: {{left: {left}, right: {right}}}\n")
    drive, rejections = read_drive(root)
    assert rejections == []
    assert [p.captured_at_ns for p in drive.frame_pairs] == [p.captured_at_ns for p in sample.frame_pairs]
    plan = read_header(root)
    ends = drive.frame_pairs[0].captured_at_ns, drive.frame_pairs[-1].captured_at_ns
    assert (plan.captured_from_ns, plan.captured_to_ns) == ends, "a plan needs them, to select and sort drives"
    lines = [f"{p.captured_at_ns / 1e9:.6f}" for p in sample.frame_pairs]
    (root / "times.txt").write_text("\n".join(lines[:-1]))
    (root / "drive.yaml").write_text(f"images: {{left: {left}, right: {right}, timestamps: times.txt}}\n")
    with pytest.raises(DriveFolderError, match=rf"times\.txt: 15 time stamps for the 16 images of {left}"):
        read_drive(root)
    (root / "times.txt").write_text("\n".join(lines))
    next(iter(sorted((root / right).iterdir()))).unlink()
    with pytest.raises(
        DriveFolderError, match=rf"for the 15 images of {right}.*images: \{{right_timestamps: right.txt"
    ):
        read_drive(root)
    (root / "right.txt").write_text("\n".join(lines[1:]))
    text = f"images: {{left: {left}, right: {right}, timestamps: times.txt, right_timestamps: right.txt}}\n"
    (root / "drive.yaml").write_text(text)
    assert len(read_drive(root)[0].frame_pairs) == COUNT - 1


def named_by_time(root: Path, sample: Drive, name_of: Callable[[int], str]) -> None:
    """A folder for `init`, whose images have a name that their time makes."""
    for camera, side in (("image_02", "left"), ("image_03", "right")):
        (root / side).mkdir(parents=True)
        for n, pair in enumerate(sample.frame_pairs):
            name = name_of(pair.captured_at_ns)
            (root / side / f"{name}{'_R' * (side == 'right')}.jpg").hardlink_to(SAMPLE / camera / f"data/{n:010d}.jpg")
    write_rig_yaml(sample.rig, root / "rig.yaml")
    write_csv(root, video_drives.known_of(sample))


def civil(form: str, hours: int = 0) -> Callable[[int], str]:
    """Names by a form of `strftime`, and of ms, us and ns, in a time zone."""
    zone = timezone(timedelta(hours=hours))

    def name_of(ns: int) -> str:
        whole, rest = divmod(ns, 10**9)
        return datetime.fromtimestamp(whole, zone).strftime(form).format(ms=rest // 10**6, us=rest // 1000, ns=rest)

    return name_of


@pytest.mark.parametrize(
    ("name_of", "has_zone"),
    [
        (civil("%Y%m%d_%H%M%S_{ms:03d}"), False),
        (civil("cam0-%Y%m%dT%H%M%S.{ms:03d}Z"), True),
        (civil("IMG_%Y-%m-%d_%H-%M-%S-{us:06d}_left"), False),
        (civil("%Y%m%d%H%M%S{us:06d}"), False),
        (civil("%Y%m%dT%H%M%S.{ms:03d}+0100", 1), True),
        (lambda ns: f"{ns // 10**9}_{ns // 10**6 % 1000:03d}", True),
        (lambda ns: f"drive_20260302_{ns / 10**9:.2f}", True),
        (lambda ns: f"{ns // 10**6}", True),
        (lambda ns: f"frame_000017_{ns // 10**3}", True),
        (lambda ns: f"left-{ns}", True),
    ],
)
def test_names_of_images_are_times(
    name_of: Callable[[int], str], has_zone: bool, tmp_path: Path, sample: Drive
) -> None:
    named_by_time(tmp_path / "run", sample, name_of)
    made = init(tmp_path / "run")
    assert made.exit_code == 0 and "16 frame pairs" in made.output, (made.output, made.exception)
    found = [p.captured_at_ns for p in read_drive(tmp_path / "run")[0].frame_pairs]
    assert found == [p.captured_at_ns for p in sample.frame_pairs]
    assert ("the times of the images state no time zone and are taken as UTC" in made.output) != has_zone


def test_names_of_images_in_local_time(tmp_path: Path, sample: Drive) -> None:
    root = tmp_path / "run"
    named_by_time(root, sample, civil("%Y%m%d_%H%M%S_{ms:03d}", 1))
    made = init(root)
    assert made.exit_code == 1 and "timestamps_timezone: Europe/Berlin" in made.output, made.output
    with (root / "drive.yaml").open("a") as file:
        file.write("timestamps_timezone: Europe/Berlin\n")
    inspected = CliRunner().invoke(app, ["inspect", str(root)])
    assert "state no time zone and are taken as Europe/Berlin" in inspected.output
    assert read_header(root).captured_from_ns == sample.frame_pairs[0].captured_at_ns // 10**6 * 10**6


def seconds(ns: int) -> int:
    """Whole seconds since 1970, as if an image was taken every second."""
    return 1772444467 + (ns - 1772444467250000000) // 10**8


@pytest.mark.parametrize(
    ("name_of", "understood"),
    [
        (lambda ns: civil("%Y%m%d_%H%M%S")(seconds(ns) * 10**9), "20260302_094107: 2026-03-02 09:41:07, but whole seconds"),
        (lambda ns: f"{seconds(ns)}", "1772444467: 1772444467, but whole seconds"),
        (lambda ns: f"20260302_104107_{seconds(ns) % 1000:04d}", "2026-03-02 10:41:07, then numbers of 4 digits"),
        (lambda ns: f"{ns // 10**9}_{ns // 10**6 % 1000}", "1772444467, then numbers of 2 or 3 digits"),
        (lambda ns: f"20260302_104107_{seconds(ns) % 1000:03d}", "2026-03-02 10:41:07, then numbers that count the images"),
    ],
)  # fmt: skip
def test_names_that_may_be_times_or_not_are_refused(
    name_of: Callable[[int], str], understood: str, tmp_path: Path, sample: Drive
) -> None:
    named_by_time(tmp_path / "run", sample, name_of)
    made = init(tmp_path / "run")
    assert understood in missing(made)["images.timestamps"]


def test_names_of_images_that_are_frame_numbers_need_a_file_of_times(tmp_path: Path, sample: Drive) -> None:
    root = tmp_path / "run"
    for camera, side in (("image_02", "left"), ("image_03", "right")):
        (root / side).mkdir(parents=True)
        for n in range(COUNT):
            (root / side / f"{n:04d}.jpg").hardlink_to(SAMPLE / camera / f"data/{n:010d}.jpg")
    write_rig_yaml(sample.rig, root / "rig.yaml")
    write_csv(root, video_drives.known_of(sample))
    made = init(root, "images.timestamps=time.txt")
    assert "images.timestamps: there is no file or folder time.txt in " in str(made.exception)
    assert not (root / "drive.yaml").exists()
    said = missing(init(root, "images.start=2026-03-02 09:41:07Z"))["images.timestamps"]
    assert "names of the images in left (0000.jpg to 0015.jpg) are not times" in said
    assert "images.start is for videos" in said
    assert "are not times" in str(read_header(root).problem), "a plan says so, too"
    (root / "times.txt").write_text("\n".join(f"{p.captured_at_ns}" for p in sample.frame_pairs))
    (root / "local.txt").write_text("\n".join(f"{p.captured_at_ns + 3600 * 10**9}" for p in sample.frame_pairs))
    assert "local.txt, times.txt each have one time per image" in missing(init(root))["images.timestamps"]
    made = init(root, "images.timestamps=local.txt")
    assert made.exit_code == 1 and "its own are from 2026-03-02T09:41:07" in made.output
    assert "trajectory.time: Europe/Berlin" in made.output
    # The trajectory states the times, too, if it has a record per image.
    assert "drive.csv has one record per image" in said
    for file in ("times.txt", "drive.csv"):
        made = init(root, f"images.timestamps={file}")
        assert made.exit_code == 0 and "16 frame pairs" in made.output, made.output
        drive, _ = read_drive(root)
        assert [p.captured_at_ns for p in drive.frame_pairs] == [p.captured_at_ns for p in sample.frame_pairs]
    rows = (root / "drive.csv").read_text().splitlines(keepends=True)
    (root / "drive.csv").write_text("".join(rows[:-1]))
    with pytest.raises(DriveFolderError, match=r"15 valid and 0 bad records, but 16 images of left"):
        read_drive(root)
    (root / "drive.yaml").unlink()
    (root / "drive.csv").rename(root / "short.csv")
    assert "one record per image;" not in missing(init(root))["images.timestamps"]
    (root / "local.txt").unlink()
    made = init(root)  # the only file with one time per image
    assert made.exit_code == 0 and "times of the images: times.txt" in made.output, made.output


@pytest.mark.parametrize("broken", ["mount: {forward_m: 1070, left_m: 0, up_m: 0}\n", "mount: {\n"])
def test_init_leaves_a_drive_yaml_with_a_wrong_value(broken: str, tmp_path: Path, sample: Drive) -> None:
    """Its folders of images are no KITTI drive."""
    root = tmp_path / "run"
    named_by_time(root, sample, lambda ns: f"{ns}")
    for side, name in (("left", "Cam_L"), ("right", "Cam_R")):
        (root / side).rename(root / name)
    (root / "drive.yaml").write_text(f"images: {{left: Cam_L, right: Cam_R}}\n{broken}")
    options = "images.left=Cam_L", "mount={forward_m: 1.07, left_m: 0, up_m: 0}"
    assert "drive.yaml was not written by 'conetl init'" in str(init(root, *options).exception)
    assert "drive.yaml" in str(init(root, "--force", *options).exception)
    assert broken in (root / "drive.yaml").read_text(), "what a person wrote stays"
    (root / "drive.yaml").unlink()
    made = init(root, *options)
    assert made.exit_code == 0 and "16 frame pairs" in made.output, (made.output, made.exception)


def test_what_is_missing_is_named(folder: Path, tmp_path: Path, sample: Drive) -> None:
    start = "images: {start: '2026-03-02 10:00:00Z', right_offset_s: 0"
    for number, (text, message) in enumerate(
        {
            "images: {layout: left-right, left: left.mp4, start: '2026-03-02 10:00:00'}": "480 x 320 pixels, but the calibration",
            start + ", left: front.mp4}": "there is no file or folder 'front.mp4'",
            "images: {from_s: 5, to_s: 2}": "to_s 2 is not after from_s 5",
            "images: {start: yesterday, right_offset_s: 0}": "drive.yaml: images.start: expected a time stamp",
            start + "}\ntrajectory: {file: rover.pos}": "rover.pos",
            start + ", left: left.mp4, right: stills}": "left.mp4: this is a file, .* name two files or two folders",
            start + "}\ntrajectory: {file: ../drive.csv}": "outside the drive folder",
        }.items()
    ):
        copy = copied(folder, tmp_path / str(number), settings=text)
        (copy / "stills").mkdir()
        (copy / "stills/0.jpg").touch()
        with pytest.raises(InputError, match=message):
            read_drive(copy)
    for name, message in (("drive.csv", "which file is the trajectory"), ("rig.yaml", r"rig\.yaml is missing")):
        copy = copied(folder, tmp_path / f"without {name}", name, settings=start + "}")
        with pytest.raises(InputError, match=message):
            read_drive(copy)
    still = copied(folder, tmp_path / "still", "right.mp4", settings="images: {start: '2026-03-02 09:41:07'}")
    image, times = np.full((320, 960, 3), 90, np.uint8), [pair.captured_at_ns for pair in sample.frame_pairs]
    video_drives.write_frames(still / "right.mp4", [image] * COUNT, times, "libx264", {})
    with pytest.raises(DriveFolderError, match=r"the time shift between right\.mp4 and left\.mp4 cannot be estimated"):
        read_drive(still)


def test_a_mount_takes_the_place_of_the_pose_in_the_rig(folder: Path, tmp_path: Path) -> None:
    rig = read_rig_yaml(folder / "rig.yaml")
    free = rig.model_copy(
        update={"body_SE3_left": np.eye(4).tolist(), "body_SE3_right": rigs.left_SE3_right(rig).tolist()}
    )
    copy = copied(folder, tmp_path, "rig.yaml", settings=(folder / "drive.yaml").read_text())
    write_rig_yaml(Rig.model_validate(free), copy / "rig.yaml")
    with pytest.raises(InputError, match="the mount of the cameras is unknown"):
        read_drive(copy)
    with (copy / "drive.yaml").open("a") as file:
        file.write("mount: {forward_m: 1.5, left_m: 0.2, up_m: 0.4, pitch_deg: 10, yaw_deg: 5}\n")
    pose = np.array(read_drive(copy)[0].rig.body_SE3_left)
    assert pose[:3, 3] == pytest.approx([1.5, 0.2, 0.4])
    ahead = pose[:3, 2]  # the optical axis on the body
    assert np.degrees(np.arcsin(ahead[2])) == pytest.approx(-10)
    assert np.degrees(np.arctan2(ahead[1], ahead[0])) == pytest.approx(5)


def test_one_recording_is_a_drive_for_each_stereo_pair(folder: Path, tmp_path: Path) -> None:
    """Of a rig of four cameras, two of which are one metre to the left of the others."""
    rig = read_rig_yaml(folder / "rig.yaml")
    cameras = {}
    for name, aside_m in (("main", 0.0), ("wide", 1.0)):
        for side in ("left", "right"):
            pose = rigs.body_SE3_camera(rig, side) + np.outer([0, aside_m, 0, 0], [0, 0, 0, 1])
            camera = rigs.camera_of(rig, side).model_dump(exclude={"lens"})
            cameras[f"{name}_{side}"] = camera | {
                "body_SE3_camera": {"R": pose[:3, :3].tolist(), "t_m": pose[:3, 3].tolist()}
            }
    text = (folder / "drive.yaml").read_text()
    found = {}
    for name in ("main", "wide", "none"):
        chosen = f"pair: [{name}_left, {name}_right]\n" if name != "none" else ""
        copy = copied(folder, tmp_path / name, "rig.yaml", settings=f"{text}drive_id: {name}\n{chosen}")
        (copy / "rig.yaml").write_text(yaml.safe_dump({"rig_id": "van", "cameras": cameras}))
        if not chosen:
            with pytest.raises(InputError, match=r"4 cameras.*'pair: \[LEFT, RIGHT\]' in drive\.yaml"):
                read_drive(copy)
        else:
            found[name] = read_drive(copy)[0]
    lefts = [rigs.body_SE3_camera(found[name].rig, "left")[:3, 3] for name in ("main", "wide")]
    assert np.subtract(*lefts) == pytest.approx([0.0, -1.0, 0.0])
    assert found["main"].rig.rig_id == "van-main_left-main_right"


def test_frames_are_found_for_people_inside_the_drive_only(folder: Path) -> None:
    drive, _ = read_drive(folder)
    path = drive.frame_pairs[0].left_path
    assert str(image_file(str(folder), path)) == path
    for wrong in ("../left.mp4#pts=0", "/etc/passwd#pts=0", f"{folder}/none.mp4#pts=0"):
        with pytest.raises(ImageMissingError):
            image_file(str(folder), wrong)


# --------------------------------------------------------------------------- conetl init


def test_init_writes_what_the_folder_says(folder: Path, tmp_path: Path, sample: Drive) -> None:
    copy = copied(folder, tmp_path)
    known = (f"images.start={start_of(sample)}",)
    made = init(copy, *known)
    assert made.exit_code == 0, made.output
    assert "video left.mp4 and right.mp4: 960 x 320, 16 frames" in made.output and "a right file" not in made.output
    assert "16 frame pairs" in made.output and f"conetl ingest {copy}" in made.output
    assert len(read_drive(copy)[0].frame_pairs) == COUNT
    written = (copy / "drive.yaml").read_text()
    again = init(copy)
    assert again.exit_code == 0 and (copy / "drive.yaml").read_text() == written
    part = init(copy, "images.every=3", "images.from_s=0.15", "images.to_s=1.05")
    assert part.exit_code == 0, part.output
    whole, shorter = sample.frame_pairs[0].captured_at_ns, [p.captured_at_ns for p in read_drive(copy)[0].frame_pairs]
    assert [round((t - whole) / 1e8) for t in shorter] == [2, 5, 8]  # of frames 0.1 s apart
    assert "images: to_s 2 is not after from_s 5" in str(init(copy, "images.from_s=5", "images.to_s=2").exception)
    assert init(copy, "images.every=", "images.from_s=", "images.to_s=").exit_code == 0
    assert (copy / "drive.yaml").read_text() == written, "values that are removed"
    named = tmp_path / "a b"
    named.symlink_to(SAMPLE)
    drive = CliRunner().invoke(app, ["init", str(named), "--json"])
    assert json.loads(drive.output)["next"][1] == f"conetl ingest '{named}'"
    assert "is already a drive (kitti): write its settings into drive.yaml" in str(init(named, *known).exception)


@pytest.mark.parametrize("suffix", [".svo", ".svo2"])
def test_recordings_of_zed_cameras_name_the_tool_that_exports_them(
    suffix: str, folder: Path, tmp_path: Path, sample: Drive
) -> None:
    copy = copied(folder, tmp_path, "left.mp4", "right.mp4")
    recording = copy / f"road{suffix}"
    recording.write_bytes(b"ZED")
    said = f"{recording}: .*'svo_export.py --mode 0' and give the AVI to 'conetl init'"
    for path in (copy, recording):
        with pytest.raises(DriveFolderError, match=said):
            read_drive(path)
        assert re.match(said, str(init(path).exception))
    assert "there is no such folder" in str(init(copy / f"other{suffix}").exception)
    both = [np.hstack([read_pair_image(p, s, sample.rig) for s in ("left", "right")]) for p in sample.frame_pairs]
    times_ns = [pair.captured_at_ns for pair in sample.frame_pairs]
    video_drives.write_frames(copy / "road.avi", both, times_ns, "mjpeg", {"q:v": "2"}, 10)
    made = init(copy, "images.layout=left-right", f"images.start={start_of(sample)}")
    assert made.exit_code == 0 and "16 frame pairs" in made.output, (made.output, made.exception)


def test_init_lists_what_is_missing(folder: Path, tmp_path: Path) -> None:
    copy = copied(folder, tmp_path, "rig.yaml", "drive.csv")
    for side in ("left", "right"):
        (copy / f"{side}.mp4").rename(copy / f"GX01_{len(side)}.mp4")
    assert "images.left: there is no file or folder 'GX02.mp4' in" in str(init(copy, "images.left=GX02.mp4").exception)
    assert not (copy / "drive.yaml").exists()
    assert list(missing(init(copy))) == ["images.left", "trajectory.file", "rig"], "of two videos, the other one"
    (copy / "GX01_5.mp4").rename(copy / "right.mp4")
    assert "images.left" not in missing(init(copy))
    (copy / "log.csv").touch()
    for header, key in (
        ("time,easting,northing,h", "crs"),
        ("time,lat,lon,h_msl", "heights"),
        ("Ortszeit,lat,lon,h", "time"),
    ):
        lines = (f"2024-02-07 10:15:0{second},49.000{second},8,110\n" for second in range(2))
        (copy / "log.csv").write_text("".join((header, "\n", *lines)))
        assert "drive.yaml" not in missing(init(copy))[f"trajectory.{key}"], "which conetl init writes"


def test_a_drive_yaml_with_places_for_what_is_missing_can_be_completed(
    folder: Path, tmp_path: Path, sample: Drive
) -> None:
    copy = copied(folder, tmp_path, "rig.yaml", "drive.csv")
    WRITERS["opencv"](read_rig_yaml(folder / "rig.yaml"), copy / "stereo.yml")
    video_drives.LOGS["GPX"].write(copy, video_drives.known_of(sample))
    path = copy / "drive.yaml"
    assert list(missing(init(copy))) == ["images.start", "sigmas.horizontal_m", "mount"]
    text = path.read_text()
    assert "  # NEEDED, like 0.02: Accuracy of the positions, horizontally, in metres" in text
    assert "  # every: 2  # Use every n-th frame pair." in text
    empty = re.findall(r"^  (\w+):$", text, re.MULTILINE)
    assert empty == ["horizontal_m", "forward_m", "left_m", "up_m", "pitch_deg"]
    assert len(missing(init(copy))) == 3 and path.read_text() == text
    with pytest.raises(DriveFolderError, match=r"rig\.yaml is missing"):
        read_drive(copy)
    path.write_text(text.replace("  forward_m:\n", "  forward_m: 1.5\n"))
    assert f"settings {path}: mount.left_m: is missing" in str(init(copy).exception)
    for key, value in {"horizontal_m": 0.02, "forward_m": 1.5, "left_m": 0.2, "up_m": 0.4}.items():
        text = text.replace(f"  {key}:\n", f"  {key}: {value}\n")
    path.write_text(text.replace("# drive_id: morning-run", "drive_id: ring road"))
    made = init(copy)
    assert list(missing(made)) == ["images.start"] and "left camera: 1.5 m in front of" in made.output
    # A time needs no quotes, and keeps its digits.
    path.write_text(path.read_text().replace("  start:\n", f"  start: {start_of(sample)}\n"))
    made = init(copy)
    assert made.exit_code == 0 and "NEEDED" not in path.read_text(), (made.output, made.exception)
    assert yaml.safe_load(path.read_text()) == {
        "drive_id": "ring road", "images": {
            "left": "left.mp4", "right": "right.mp4", "start": start_of(sample), "right_offset_s": 0.0,
        },
        "trajectory": {"file": "van.gpx"}, "sigmas": {"horizontal_m": 0.02},
        "mount": {"forward_m": 1.5, "left_m": 0.2, "up_m": 0.4}, "clock": None, "shutter": None,
    }  # fmt: skip
    # As much can be stated by options.
    again = copied(copy, tmp_path / "again", "rig.yaml")
    options = (
        "sigmas.horizontal_m=0.02",
        "drive_id=ring road",
        "mount.forward_m=1.5",
        "mount.left_m=0.2",
        "mount.up_m=0.4",
    )
    made = init(again, *options, f"images.start={start_of(sample)}")
    assert made.exit_code == 0 and yaml.safe_load((again / "drive.yaml").read_text()) == yaml.safe_load(
        path.read_text()
    )


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("start=noon", "--set start: drive.yaml has no such key; did you mean images.start?"),
        ("mount.foward_m=1", "did you mean mount.forward_m?"),
        ("colour=red", "drive.yaml has no such key; they are listed in docs/reference/drive_yaml.md"),
        ("=red", "--set '=red': expected KEY=VALUE, like images.every=2"),
        ("images.every=two", "--set: images.every: expected a whole number, found 'two'"),
        ("images.layout=noon", "--set: images.layout: expected 'left-right', 'right-left'"),
        ("images.start=noon", "images.start: expected a time stamp"),
        ("trajectory.date=noon", "--set: trajectory.date: expected a date like 2026-03-02"),
        ("trajectory.time=noon", "expected utc, gps or a zone"),
        ("trajectory.columns=Messzeit,2", "--set: trajectory.columns: expected keys and values"),
        ("mount={forward_m: 1,07, left_m: 0, up_m: 1}", "--set: mount.7: unknown key"),
        ("mount.forward_m={1", "--set mount.forward_m: this is not YAML"),
        ("mount.up_m=1", "--set: mount.forward_m: is missing"),
        ("images.left.name=a", "--set images.left.name: drive.yaml has no such key"),
    ],
)  # fmt: skip
def test_a_wrong_value_names_its_key_and_changes_nothing(word: str, says: str, folder: Path, tmp_path: Path) -> None:
    copy = copied(folder, tmp_path)
    made = init(copy, word)
    assert isinstance(made.exception, InputError) and says in str(made.exception), (made.output, made.exception)
    assert not (copy / "drive.yaml").exists()


def test_names_of_files_do_not_change_the_meaning_of_a_template(tmp_path: Path) -> None:
    """Causes quote files, and comments end with their line."""
    for name in ("a\nmount: 3", "b\x85mount: 3", "c\u2028mount: 3", "d\x07 # ", "Höhe: 'x'"):
        text = template({"images": {"left": name}}, [Missing("images.right", f"Found: {name}", name)])
        (tmp_path / "drive.yaml").write_text(text, encoding="utf-8")
        assert read_drive_yaml(tmp_path).model_dump(exclude_unset=True) == {"images": {"left": name}}, text
        assert is_template(tmp_path / "drive.yaml")


@pytest.mark.parametrize(
    "settings",
    [
        {"clock": {}}, {"clock": {"offset_s": "estimate"}}, {"pair": ["a", "b"], "cameras": {"left": "image_01"}},
        {"control_points": {"file": "points.csv", "sigma_m": 0.02}, "antenna_t_m": [0.4, -0.2, 1.1], "map_srid": 25832},
        {"common_errors": [{"id": "base", "sigma_m": 0.02}, {"id": "roof", "sigma_m": [0.1, 0, 0], "axes": "vehicle"}]},
        {"trajectory": {"date": "2024-02-07", "delimiter": " ", "decimal": ",", "columns": {"time": 1, "lat": "Höhe, ell."}}},
        {"images": {"start": "2026-03-02 10:00:00.250Z", "layout": "left-right"}, "timestamps_timezone": "Europe/Berlin"},
    ],
)  # fmt: skip
def test_a_template_states_the_same_settings(settings: dict[str, object], tmp_path: Path) -> None:
    (tmp_path / "drive.yaml").write_text(template(settings, []), encoding="utf-8")
    assert read_drive_yaml(tmp_path) == DriveYaml.model_validate(settings)


def test_every_key_of_a_template_is_one_of_drive_yaml() -> None:
    """Also those that are comments."""
    text = re.sub(r"^(\s*)# (\w+: )", r"\1\2", template({}, [Missing("mount")]), flags=re.MULTILINE)
    text = re.sub(r"^  (\w+):$", r"  \1: 1", text, flags=re.MULTILINE)
    read = DriveYaml.model_validate(yaml.safe_load(text))
    assert (read.mount, read.images.every, read.trajectory.heights) == (
        Mount(forward_m=1, left_m=1, up_m=1, pitch_deg=1, yaw_deg=-1.5, roll_deg=0.5), 2, "EPSG:5773"
    )  # fmt: skip
    assert all(field.description for key, field in KEYS.items() if field.examples)


def test_init_names_the_drive_inside_a_folder(folder: Path, tmp_path: Path) -> None:
    drive = shutil.copytree(folder, tmp_path / "day/run")
    assert f"run is a drive already: conetl ingest {drive}" in str(init(tmp_path / "day").exception)


def test_init_needs_to_know_the_columns_of_a_table(folder: Path, tmp_path: Path, sample: Drive) -> None:
    copy = copied(folder, tmp_path)
    log = copy / "drive.csv"
    rows = [line.split(",")[:7] for line in log.read_text().splitlines()[2:]]
    log.unlink()
    names = ["Messzeit", "geogr. Breite", "geogr. Länge", "Höhe, ell.", "Wanken [°]", "Nicken [°]", "Kurs"]
    table = [";".join(names), *(";".join([row[0].rstrip("Z"), *row[1:]]) for row in rows)]
    (copy / "Fahrt.csv").write_text("\n".join(table), encoding="cp1252")
    known = [
        f"images.start={start_of(sample)}",
        "images.right_offset_s=0",
        "sigmas.horizontal_m=0.02",
        "mount={forward_m: 1, left_m: 0, up_m: 1}",
    ]
    said = missing(init(copy, *known))["trajectory.file"]
    assert "none was recognised; there is Fahrt.csv" in said
    said = missing(init(copy, "trajectory.file=Fahrt.csv"))["trajectory.columns"]
    assert "Which columns of a table contain what" in said and "found Messzeit, geogr. Breite, " in said, said
    assert "drive.yaml" not in said, said
    columns = "trajectory.columns={time: Messzeit, lat: 2, lon: 3, height: 4, roll: 5, pitch: 6, heading: Kurs}"
    made = init(copy, columns)
    assert made.exit_code == 0, made.exception
    assert "Fahrt.csv: times taken as UTC; if they are local" in made.output, made.output
    assert "Fahrt.csv: heights taken as ellipsoidal; if they are not" in made.output, made.output
    assert (
        "left camera: 1 m in front of, 0 m left of and 1 m above the antenna or IMU, looks 0 degrees down, as no pitch"
        in made.output
    )
    assert "positions in EPSG:32632 with ellipsoidal heights" in made.output
    stated = yaml.safe_load((copy / "drive.yaml").read_text())["trajectory"]["columns"]
    assert stated == {"time": "Messzeit", "lat": 2, "lon": 3, "height": 4, "roll": 5, "pitch": 6, "heading": "Kurs"}
    assert len(read_drive(copy)[0].frame_pairs) == COUNT
    # The columns stay, whatever characters their names have; a line without time is not why no record fits.
    made = init(copy, "trajectory.columns.height='Höhe, ell.'", "trajectory.time=utc")
    assert made.exit_code == 0 and "taken as UTC" not in made.output, made.exception
    stated["height"] = "Höhe, ell."
    assert yaml.safe_load((copy / "drive.yaml").read_text())["trajectory"]["columns"] == stated
    made = init(copy, "trajectory.time=Asia/Tokyo", columns.replace("Messzeit", "1"))
    assert isinstance(made.exception, ConetlError), made.output
    assert "Fahrt.csv covers 2026-03-02 00:41:07 to 2026-03-02 00:41:" in str(made.exception), made.exception


def test_init_does_not_ask_for_columns_where_another_value_is_wrong(folder: Path, tmp_path: Path) -> None:
    copy = copied(folder, tmp_path, "drive.csv")
    rows = [f"07.02.2024;09:15:0{second};458000;542700{second};110" for second in range(5)]
    (copy / "log.csv").write_text("\n".join(["Messtag;Zeit;Ostwert;Nordwert;H", *rows]))
    log = "trajectory.file=log.csv"
    assert "does not state their coordinate reference system" in missing(init(copy, log))["trajectory.crs"]
    said = str(init(copy, "trajectory.crs=0.02").exception)
    assert (
        said.endswith("drive.yaml: trajectory.crs: '0.02' is not known to PROJ")
        or "'0.02' is not known to PROJ" in said
    ), said
    said = missing(init(copy, "trajectory.crs=25832"))["trajectory.columns"]
    assert "no usable pose: line 2: expected a time stamp like" in said and "found '09:15:00'" in said, said
    said = str(init(copy, "trajectory.columns={date: Tag}").exception)
    assert "has no column 'Tag', which trajectory.columns names; its columns are Messtag, Zeit" in said, said
    said = missing(init(copy, "trajectory.columns={date: Messtag}"))
    assert list(said) == ["images.start", "sigmas.horizontal_m"] and "May be left out" in said["images.start"]


def test_heights_of_unknown_reference_are_named(
    folder: Path, tmp_path: Path, sample: Drive, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = copied(folder, tmp_path, "drive.csv")
    log = write_gpx(copy, video_drives.known_of(sample), geoid=False)
    known = [f"images.start={start_of(sample)}", "images.right_offset_s=0", "sigmas.horizontal_m=0.02"]
    remark = (
        f"{log}: does not state whether its heights are above sea level or the ellipsoid: vertical sigma 100 m. Put "
        "into drive.yaml, below trajectory, heights: 'EPSG:5773' (sea level, EGM96) or heights: ellipsoidal"
    )
    made = init(copy, *known)  # which nobody has to answer
    assert made.exit_code == 0 and remark in made.output, made.output
    assert read_header(copy).remarks == (remark,)
    monkeypatch.setattr("conetl.cli.ingest.require_room", lambda _: (_ for _ in ()).throw(InputError("stop here")))
    ingested = CliRunner().invoke(app, ["ingest", str(copy)])
    assert str(ingested.exception) == "stop here" and f"note: {remark}" in ingested.output, ingested.output
    assert f"note: {remark}" in CliRunner().invoke(app, ["inspect", str(copy)]).output
    assert max(pair.pose.sigma_enu_m[2] for pair in read_drive(copy)[0].frame_pairs) > 100
    assert remark not in init(copy, "trajectory.heights=ellipsoidal").output
    assert read_header(copy).remarks == ()
    assert read_drive(copy)[0].frame_pairs[0].pose.sigma_enu_m[2] < 1
    assert remark in init(copy, "trajectory.heights=").output
    settings = yaml.safe_load((copy / "drive.yaml").read_text())
    assert "heights" not in settings["trajectory"]
    for section, key, value in (
        ("trajectory", "heights", "EPSG:5773"), ("trajectory", "crs", "EPSG:4979"), ("sigmas", "vertical_m", 20),
    ):  # fmt: skip
        (copy / "drive.yaml").write_text(yaml.safe_dump(settings | {section: settings[section] | {key: value}}))
        assert read_header(copy).remarks == (), key
    write_gpx(copy, video_drives.known_of(sample))
    (copy / "drive.yaml").write_text(yaml.safe_dump(settings))
    assert read_header(copy).remarks == (), "the geoid is in the file"


def test_init_takes_the_size_of_the_images_where_a_calibration_has_none(folder: Path, tmp_path: Path) -> None:
    copy = copied(folder, tmp_path, "rig.yaml")
    WRITERS["opencv"](read_rig_yaml(folder / "rig.yaml"), tmp_path / "stereo.yml")
    text = "\n".join(x for x in (tmp_path / "stereo.yml").read_text().splitlines() if not x.startswith("image_"))
    (copy / "stereo.yml").write_text(text)
    made = init(copy)
    assert "calibration stereo.yml (OpenCV stereo calibration): 960 x 320" in made.output
    # Not that of images of another size: its principal point would be off their centre.
    (copy / "stereo.yml").write_text(text.replace("478.", "956."))
    made = init(copy)
    assert "stereo.yml is not used as a calibration: 'image_width, image_height' are missing" in made.output
    assert "rig" in missing(made)
    # Which is not known before it is known how the images lie in a file.
    (copy / "stereo.yml").write_text(text)
    (copy / "right.mp4").unlink()
    (copy / "drive.yaml").unlink()
    made = init(copy)
    assert "images.layout" in missing(made) and "rig" not in missing(made)
    assert "stereo.yml" not in made.output


def test_init_takes_the_calibration_of_kitti(folder: Path, tmp_path: Path) -> None:
    copy = copied(folder, tmp_path, "rig.yaml")
    (copy / "calib_cam_to_cam.txt").hardlink_to(SAMPLE / "calib_cam_to_cam.txt")
    made = init(
        copy,
        "images.start=2026-03-02 09:41:07.25Z",
        "images.right_offset_s=0",
        "mount={forward_m: 1, left_m: 0, up_m: 0.7, pitch_deg: 2}",
    )
    assert made.exit_code == 0 and "calibration calib_cam_to_cam.txt (KITTI" in made.output, (
        made.output,
        made.exception,
    )


def test_init_takes_a_calibration_in_millimetres_that_states_no_unit(folder: Path, tmp_path: Path) -> None:
    copy, rig = copied(folder, tmp_path, "rig.yaml"), read_rig_yaml(folder / "rig.yaml")
    WRITERS["opencv"](rig, tmp_path / "stereo.yml")
    unstated = ("image_", "length_unit")
    lines = [line for line in (tmp_path / "stereo.yml").read_text().splitlines() if not line.startswith(unstated)]
    text = "\n".join(lines)
    begin = text.index("data: [", text.index("\nT:")) + len("data: [")
    for baseline, taken in (("-540.2", True), ("-54000", False)):
        end = text.index("]", begin)
        (copy / "stereo.yml").write_text(f"{text[:begin]} {baseline}, 0., 0. {text[end:]}")
        made = init(copy)
        assert ("lengths taken as mm): 960 x 320, baseline 0.540 m" in made.output) is taken, made.output
        assert ("stereo.yml is not used as a calibration" in made.output) is not taken


def test_init_knows_the_layout_by_the_size_of_the_calibration(tmp_path: Path, sample: Drive) -> None:
    few = sample.model_copy(update={"frame_pairs": sample.frame_pairs[:4]})
    for layout in ("left-right", "top-bottom"):
        root = video_drives.write_video_drive(tmp_path / layout, few, layout=layout)
        (root / "drive.yaml").unlink()
        made = init(root, f"images.start={start_of(sample)}")
        assert made.exit_code == 0 and f"both.mp4: layout {layout}, by the size" in made.output, made.output
        assert yaml.safe_load((root / "drive.yaml").read_text())["images"]["layout"] == layout
    (root / "drive.yaml").unlink()
    (root / "rig.yaml").rename(tmp_path / "rig.yaml")
    assert "images.layout" in missing(init(root))
    made = init(root, "--rig", str(tmp_path / "rig.yaml"), f"images.start={start_of(sample)}")
    assert made.exit_code == 0, made.exception


def test_init_suggests_the_first_record_of_a_log_with_one_per_frame(
    folder: Path, tmp_path: Path, sample: Drive
) -> None:
    copy = copied(folder, tmp_path)
    made = init(copy)
    assert f"that was at {start_of(sample)}" in missing(made)["images.start"]
    assert f"--set 'images.start={start_of(sample)}'" in made.output
    made = init(copy, f"images.start={start_of(sample)}")
    assert made.exit_code == 0, made.output
    (copy / "drive.yaml").unlink()
    rows = (copy / "drive.csv").read_text().splitlines(keepends=True)
    (copy / "drive.csv").unlink()
    (copy / "short.csv").write_text("".join(rows[:-1]))
    assert "that was at" not in missing(init(copy))["images.start"]


def test_init_finds_files_that_are_named_from_the_current_folder(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = copied(folder, tmp_path)
    (copy / "rig.yaml").rename(tmp_path / "van.yaml")
    (copy / "left.mp4").rename(copy / "a.mp4")
    monkeypatch.chdir(tmp_path)
    files = ["images.left=copy/a.mp4", "trajectory.file=copy/drive.csv", "--rig", "van.yaml"]
    made = init(Path("copy"), "images.right_offset_s=0", "images.start=2026-03-02 09:41:07.25", *files)
    assert made.exit_code == 0, (made.exception, made.output)
    stated = yaml.safe_load((copy / "drive.yaml").read_text())
    assert (stated["images"]["left"], stated["trajectory"]["file"]) == ("a.mp4", "drive.csv")
    assert (copy / "rig.yaml").is_file()


def test_init_takes_no_shift_that_the_images_contradict(folder: Path, tmp_path: Path, whole: Drive) -> None:
    """Files of equally many frames, the right one a frame late, on a road that shows no pitching."""
    copy = copied(folder, tmp_path)
    (copy / "right.mp4").unlink()
    late = whole.frame_pairs[1 : COUNT + 1]
    images, times_ns = [read_pair_image(pair, "right", whole.rig) for pair in late], [p.captured_at_ns for p in late]
    video_drives.write_frames(copy / "right.mp4", images, times_ns, "libx264", {"crf": "18"})
    made = init(copy, f"images.start={start_of(whole)}")
    assert "Seconds by which the right file begins" in missing(made)["images.right_offset_s"], made.output


def test_a_start_without_a_fraction_of_a_second_is_uncertain(folder: Path, tmp_path: Path) -> None:
    """As people copy the time of creation from a video's container: half a second is metres on the road."""
    for start, sigma_s in (("2026-03-02 09:41:07Z", 0.29), ("2026-03-02 09:41:07.000Z", None)):
        copy = copied(folder, tmp_path / str(sigma_s))
        made = init(copy, f"images.start={start}", "images.right_offset_s=0")
        assert made.exit_code == 0, made.exception
        assert ("its sigma is 0.29 s" in made.output) is (sigma_s is not None)
        assert read_drive(copy)[0].clock_sigma_s == sigma_s
        if sigma_s:
            first, last = (read_drive(copy)[0].frame_pairs[k] for k in (0, -1))
            driven_m = np.linalg.norm(np.subtract(last.pose.map_t_body_m, first.pose.map_t_body_m)[:2])
            along_m = 0.29e9 * driven_m / (last.captured_at_ns - first.captured_at_ns)
            assert f"along the road becomes {along_m:.1f} m" in made.output and along_m > 3


def test_init_names_a_start_that_the_images_do_not_show(folder: Path, tmp_path: Path) -> None:
    copy = copied(folder, tmp_path)
    made = init(copy, "images.right_offset_s=0")
    assert "time of creation" not in missing(made)["images.start"]
    (copy / "left.mp4").unlink()
    with av.open(str(folder / "left.mp4")) as source, av.open(str(copy / "left.mp4"), "w") as container:
        container.metadata["creation_time"] = "2026-03-02T09:41:07Z"
        stream = container.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                container.mux(packet)
    made = init(copy, "images.right_offset_s=0")
    assert "left.mp4 states 2026-03-02 09:41:07 UTC as its time of creation" in missing(made)["images.start"]
    (copy / "left.mp4").unlink()
    (copy / "left.mp4").hardlink_to(folder / "left.mp4")
    rows = (copy / "drive.csv").read_text().splitlines()
    (copy / "drive.csv").unlink()
    (copy / "drive.csv").write_text("\n".join([*rows, rows[-1].replace("T09:", "T19:", 1)]))
    made = init(copy, "images.right_offset_s=0")
    assert "hours with the video) to search" in missing(made)["images.start"]
    made = init(copy, "images.start=2026-03-02 22:41:07.250")
    assert "the video is of another time; state images.start with its offset" in str(made.exception)
    assert "22:41" not in (copy / "drive.yaml").read_text()


def test_init_keeps_what_the_file_states(folder: Path, tmp_path: Path, sample: Drive) -> None:
    start = "2026-03-02 09:41:07Z"
    copy = copied(
        folder,
        tmp_path,
        settings="drive_id: ring road\n"
        f"images: {{start: '{start}', right_offset_s: 0, every: 2, left: left.mp4, right: right.mp4}}\n"
        "trajectory: {file: drive.csv}\nclock: {offset_s: 0.0, sigma_s: 0.02}\n"
        "mount: {forward_m: 1.5, left_m: 0.2, up_m: 0.4, pitch_deg: 10}\n",
    )

    def renewed(*options: str) -> dict[str, dict[str, object]]:
        made = init(copy, "--force", *options)
        assert made.exit_code == 0, made.output
        assert "kept from drive.yaml: " in made.output
        return dict(stated(yaml.safe_load((copy / "drive.yaml").read_text())))

    before = yaml.safe_load((copy / "drive.yaml").read_text())
    after = renewed("images.every=3")
    assert after.pop("drive_id") == "ring road" and after["images"].pop("every") == 3
    assert after["images"].pop("start") == "2026-03-02 09:41:07.000000000Z"
    assert after["images"] == {"left": "left.mp4", "right": "right.mp4", "right_offset_s": 0.0}
    assert (after["clock"], after["trajectory"]) == (before["clock"], before["trajectory"])
    assert after["mount"] == before["mount"]
    assert renewed("mount.pitch_deg=5")["mount"] == before["mount"] | {"pitch_deg": 5.0}
    # A noted start needs no clock that was found, another mount none of the earlier angles.
    after = renewed("images.start=2026-03-02 09:41:07.1Z", "mount={forward_m: 1, left_m: 2, up_m: 3}")
    assert "clock" not in after and after["mount"] == {"forward_m": 1.0, "left_m": 2.0, "up_m": 3.0}
    # Times are those of the files that they were found for.
    written = (copy / "drive.yaml").read_text()
    assert "images.start" in missing(init(copy, "images.left=right.mp4", "images.right=left.mp4"))
    (copy / "drive.yaml").write_text(written)
    (copy / "drive.csv").rename(copy / "other.csv")
    after = renewed("trajectory.file=other.csv")
    assert after["trajectory"] == {"file": "other.csv"} and after["images"]["every"] == 3
    (copy / "right.mp4").rename(copy / "r.mp4")
    after = renewed("images.right=r.mp4", "images.right_offset_s=0", f"images.start={start}")
    assert after["images"]["right"] == "r.mp4" and after["mount"]["up_m"] == 3.0
    # An answer to what the file left open changes nothing else.
    (copy / "drive.yaml").write_text(f"images: {{start: '{start}', right_offset_s: 0}}\nclock: {{offset_s: 0.01}}\n")
    after = renewed("images.right=r.mp4", "trajectory.file=other.csv")
    assert after["images"]["start"] == "2026-03-02 09:41:07.010000000Z" and after["images"]["right_offset_s"] == 0.0
    (copy / "drive.yaml").write_text(f"images: {{right: r.mp4, start: '{start}', right_offset_s: 0}}\n")
    after = renewed("common_errors.id=base-north", "common_errors.sigma_m=0.5")
    assert after["common_errors"] == [{"id": "base-north", "sigma_m": [0.5, 0.5, 0.5]}]
    assert read_drive(copy)[0].frame_pairs[0].pose.sigma_enu_m == (0.5, 0.5, 0.5)
    for value, expected in (("control_points=none.csv", "none.csv"), ("images.right=left.mp4", "the same file")):
        refused = init(copy, "--force", "images.left=left.mp4", value)
        assert expected in str(refused.exception), refused.output


def test_init_knows_cameras_by_their_letter_and_calibrations_by_the_size_of_the_images(
    folder: Path, tmp_path: Path, sample: Drive
) -> None:
    copy, rig = copied(folder, tmp_path, "rig.yaml"), read_rig_yaml(folder / "rig.yaml")
    wrong = {s: getattr(rig, s).model_copy(update={"height_px": rig.left.height_px + 2}) for s in ("left", "right")}
    write_rig_yaml(rig.model_copy(update=wrong), copy / "rig.yaml")
    WRITERS["opencv"](rig, copy / "stereo.yml")
    for side, name in (("left", "Kamera_links.mp4"), ("right", "Kamera_rechts.mp4")):
        (copy / f"{side}.mp4").rename(copy / name)
    options = [
        "mount={forward_m: 1, left_m: 0, up_m: 1}",
        f"images.start={start_of(sample)}",
        "images.right_offset_s=0",
    ]
    assert "images.left" not in missing(init(copy, *options))
    (copy / "drive.yaml").unlink()
    for side, name in (("links", "GX01_L.mp4"), ("rechts", "GX01_R.mp4")):
        (copy / f"Kamera_{side}.mp4").rename(copy / name)
    made = init(copy, *options)
    assert "calibration rig.yaml: for images of 960 x 322, these have 960 x 320" in made.output
    assert "Found: stereo.yml. It replaces rig.yaml" in missing(made)["rig"]
    made = init(copy, *options, "--rig", "stereo.yml")
    assert made.exit_code == 0, made.exception
    assert read_rig_yaml(copy / "rig.yaml").left.height_px == 320
    assert yaml.safe_load((copy / "drive.yaml").read_text())["images"]["right"] == "GX01_R.mp4"
    # Images in folders have a size, too; one file may hold both images, and nobody knows how large they are.
    for side in ("left", "right"):
        (copy / side).mkdir()
        frames = [Path(getattr(pair, f"{side}_path")) for pair in sample.frame_pairs]
        for pair, path in zip(sample.frame_pairs, frames, strict=True):
            (copy / side / f"{pair.captured_at_ns}{path.suffix}").hardlink_to(path)
    (copy / "drive.yaml").unlink()
    (copy / "GX01_R.mp4").unlink()
    made = init(copy, *options)
    assert "images.layout" in missing(made) and "rig" not in missing(made)
    (copy / "GX01_L.mp4").unlink()
    (copy / "drive.yaml").unlink()
    write_rig_yaml(rig.model_copy(update=wrong), copy / "rig.yaml")
    made = init(copy, "mount={forward_m: 1, left_m: 0, up_m: 1}")
    assert "calibration rig.yaml: for images of 960 x 322, these have 960 x 320" in made.output


def test_init_says_which_pairs_have_a_pose(folder: Path, tmp_path: Path, sample: Drive) -> None:
    copy = copied(folder, tmp_path)
    rows = (copy / "drive.csv").read_text().splitlines(keepends=True)
    (copy / "drive.csv").unlink()
    (copy / "drive.csv").write_text("".join(rows[:-4]))
    start = start_of(sample)
    made = init(copy, "images.right_offset_s=0", f"images.start={start}")
    assert made.exit_code == 0, made.output
    assert "12 of 16 frame pairs can be used." in made.output
    assert "pose missing: 4, the first: drive.csv ended 0." in made.output
    late = start.replace("2026", "2025")
    made = init(copy, f"images.start={late}")
    assert "drive.csv covers 2026-03-02 09:41:07 to 2026-03-02 09:41:08 UTC" in str(made.exception)
    made = init(copy, "images.from_s=900")
    assert made.exit_code == 1 and "was written, but the drive cannot be read yet" in made.output, made.output
    assert "kept from drive.yaml: images, trajectory" in made.output


def test_links_and_pipes_are_no_videos(folder: Path, tmp_path: Path) -> None:
    settings = "images: {start: '2026-03-02 10:00:00Z', right_offset_s: 0}"
    copy = copied(folder, tmp_path, "left.mp4", settings=settings)
    (copy / "left.mp4").symlink_to(folder / "left.mp4")
    with pytest.raises(DriveFolderError, match="outside the drive folder"):
        read_drive(copy)
    (copy / "left.mp4").unlink()
    os.mkfifo(copy / "left.mp4")
    with pytest.raises(DriveFolderError, match="this is neither a file nor a folder"):
        read_drive(copy)
    with pytest.raises(InputError, match="this is not a file"):
        video_facts(copy / "left.mp4")


def test_cameras_that_never_agree_take_no_time() -> None:
    left, right = (
        [Image(17 * 10**17 + n * 33_000_000 + off, Path(str(n))) for n in range(20_000)] for off in (0, 16_000_000)
    )
    couples = pair_by_stamp(left, right, 5_000_000)
    assert len(couples) == 40_000 and all((a is None) != (b is None) for a, b in couples)
    stamps = [image.stamp for couple in couples for image in couple if image]
    assert stamps == sorted(stamps)
