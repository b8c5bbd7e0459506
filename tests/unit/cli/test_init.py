"""`conetl init` asks once for all that a folder does not show."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from conetl.cli.app import app
from conetl.model.errors import InputError
from conetl.readers.drives import read_drive
from conetl.readers.drives.camera_files import find_streams, sides_of, stream_of
from conetl.readers.drives.image_times import texts_of_file
from tests.fuzz.readers import small_recording
from tests.recordings import folders, kitti_odometry, number, relative_times

PLACE = "{lon_deg: 8.43, lat_deg: 49.002, height_m: 116, heading_deg: 57}"


def run(*words: str, text: str = "") -> tuple[int, str]:
    made = CliRunner().invoke(app, ["init", *words], input=text)
    return made.exit_code, f"{made.output}{made.exception or ''}"


@pytest.fixture
def odometry(tmp_path: Path) -> Path:
    return kitti_odometry(tmp_path, small_recording())


def test_all_questions_are_listed_at_once_with_reasons_and_proposals(odometry: Path) -> None:
    code, said = run(str(odometry))
    assert code == 1
    listed = re.findall(r"^  --set '?([\w.]+)=", said, re.MULTILINE)
    assert listed == ["images.start", "georeference", "sigmas.horizontal_m"]
    assert "times.txt counts seconds from a time that it does not state; it was last changed at" in said
    assert "it has no position on the earth" in said and "--yes takes '20" in said
    made = CliRunner().invoke(app, ["init", str(odometry), "--json"])
    questions = {each["key"]: each for each in json.loads(made.stdout)["missing"]}
    assert questions["images.start"]["proposal"] and questions["georeference"]["proposal"] is None
    assert made.exit_code == 1 and all(each["required"] for each in questions.values())


def test_the_proposals_and_the_other_values_make_a_drive(odometry: Path) -> None:
    """In one round: what a person states, and the rest as proposed."""
    code, said = run(str(odometry), "--yes", "--set", f"georeference={PLACE}", "--set", "sigmas.horizontal_m=0.1")
    assert code == 0 and "10 frame pairs" in said, said
    drive = read_drive(odometry)[0]
    assert len(drive.frame_pairs) == 1, "the small images are all alike"
    assert drive.clock_sigma_s is None, "images and poses have the same times"


def test_each_key_of_the_written_file_stands_once(odometry: Path) -> None:
    """Also those that a section of a section has too: shutter.right."""
    for stated in ([], ["--set", "shutter={readout_ms: 12, stamp_row: first}"]):
        run(str(odometry), *stated)
        text = (odometry / "drive.yaml").read_text()
        assert text.count("readout_ms:") == text.count("stamp_row:") == 1, text


def test_a_terminal_shows_the_list_before_the_first_question(odometry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("conetl.cli.init._is_terminal", lambda: True)
    code, said = run(str(odometry), text=f"\n{PLACE}\n0.1\n")
    assert code == 0, said
    assert said.index("--set sigmas.horizontal_m") < said.index("images.start ["), "the list, then the questions"
    assert said.count("these values are missing") == 1
    assert len(read_drive(odometry)[0].frame_pairs) == 1


@pytest.mark.parametrize("names", [("droite", "gauche"), ("left_raw", "left_rect", "right_raw", "right_rect")])
def test_cameras_whose_sides_no_name_states_are_not_proposed(names: tuple[str, ...], tmp_path: Path) -> None:
    root = folders(tmp_path, small_recording())
    sides = [root / "left", root / "right"]
    for k, name in enumerate(names):
        shutil.copytree(sides[k % 2], root / name)
    for side in sides:
        shutil.rmtree(side)
    code, said = run(str(root), "--yes")
    assert code == 1 and "--set images.left=" in said and f"Found: {', '.join(names)}" in said, said


def test_what_a_log_does_not_state_is_asked_together(tmp_path: Path) -> None:
    root = folders(tmp_path, small_recording())
    (root / "drive.csv").unlink()
    rows = (f"09:41:0{7 + n / 10},49.00{n},8.43,68.2" for n in range(10))
    (root / "log.csv").write_text("\n".join(["time,lat,lon,h_msl", *rows]))
    code, said = run(str(root))
    listed = re.findall(r"^  --set '?([\w.]+)=", said, re.MULTILINE)
    assert code == 1 and set(listed) >= {"trajectory.date", "trajectory.heights", "sigmas.horizontal_m"}, said


def test_angles_in_radians_are_proposed(tmp_path: Path) -> None:
    root = folders(tmp_path, small_recording())
    (root / "drive.csv").unlink()
    rows = (f"2026-03-02T09:41:0{7 + n / 10}Z,0.85523{n},0.14713,116.2" for n in range(10))
    (root / "log.csv").write_text("\n".join(["time,lat,lon,height", *rows]))
    made = CliRunner().invoke(app, ["init", str(root), "--json"])
    questions = {each["key"]: each for each in json.loads(made.stdout)["missing"]}
    assert made.exit_code == 1 and questions["trajectory.angles"]["proposal"] == "radians", made.stdout
    assert "in the Atlantic: are latitude and longitude in radians" in str(questions["trajectory.angles"])


def test_two_files_with_times_are_a_question(tmp_path: Path) -> None:
    root = folders(tmp_path, small_recording(), name=number, times=relative_times)
    (root / "other.txt").write_text((root / "times.txt").read_text())
    code, said = run(str(root))
    assert code == 1 and "other.txt, times.txt each have one time per image" in said, said


def test_a_file_of_times_for_each_camera(tmp_path: Path) -> None:
    recording = small_recording()
    root = folders(tmp_path, recording, name=number)
    for side in ("left", "right"):
        (root / f"{side}_times.txt").write_text("".join(f"{frame.stamp_ns}\n" for frame in recording.frames))
    code, said = run(str(root), "--yes")
    assert code == 0, said
    assert "right_timestamps: right_times.txt" in (root / "drive.yaml").read_text()


TIMES = [f"177244446{n}.25" for n in range(7)]


@pytest.mark.parametrize(
    "lines",
    [
        TIMES,
        ["# seconds", *TIMES],
        ["timestamp [s]", *TIMES],
        ["index,timestamp", *(f"{n},{time}" for n, time in enumerate(TIMES))],
        [f"{n} {time}" for n, time in enumerate(TIMES, 1)],
        [f"{n:06d};  {time}" for n, time in enumerate(TIMES)],
        ["name time", *(f"{n:06d}.png {time}" for n, time in enumerate(TIMES))],
    ],
)
def test_files_of_times(lines: list[str]) -> None:
    assert texts_of_file(lines, [Path(f"{n:06d}.png") for n in range(7)]) == TIMES


def test_numbers_that_do_not_count_the_images_are_times() -> None:
    """Seconds and nanoseconds at 1 Hz; dates; and a last line that is cut."""
    paths = [Path(f"{n:06d}.png") for n in range(7)]
    for lines in (
        [f"177244446{n} 0" for n in range(7)],
        [f"2026-03-0{n + 1} 10:00:00" for n in range(7)],
        ["0 1", "1 2", "2"],
    ):
        assert texts_of_file(lines, paths) == lines


@pytest.mark.parametrize(
    ("names", "streams", "sides"),
    [
        (("a_left.png", "a_right.png", "b_left.png", "b_right.png"), ["*_left.*", "*_right.*"], ("*_left.*", "*_right.*")),
        (("left01.jpg", "right01.jpg"), ["left*.*", "right*.*"], ("left*.*", "right*.*")),
        (("x_L.tif", "x_R.tif"), ["*_L.*", "*_R.*"], ("*_L.*", "*_R.*")),
        (("cam0_1.png", "cam1_1.png"), ["cam0_*.*", "cam1_*.*"], ("cam0_*.*", "cam1_*.*")),
        (("image_0/1.png", "image_1/1.png", "image_2/1.png", "image_3/1.png"),
         ["image_0", "image_1", "image_2", "image_3"], ("image_2", "image_3")),
        (("l/GX010042.MP4", "l/GX020042.MP4", "r/GX010057.MP4"), ["l/GX??0042.MP4", "r/GX010057.MP4"],
         ("l/GX??0042.MP4", "r/GX010057.MP4")),
        (("GOPR0042.MP4", "GP010042.MP4"), ["G???0042.MP4"], (None, None)),
        (("left/rgb/1.png", "left/rgb/2.png", "right/rgb/1.png", "right/rgb/2.png"), ["left/rgb", "right/rgb"],
         ("left/rgb", "right/rgb")),
        (("front/1.png", "back/1.png"), ["back", "front"], (None, None)),
        ((".left/1.png", "left/1.png", "right/1.png"), ["left", "right"], ("left", "right")),
    ],
)  # fmt: skip
def test_streams_and_sides_of_names(
    names: tuple[str, ...], streams: list[str], sides: tuple[str | None, str | None], tmp_path: Path
) -> None:
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = find_streams(tmp_path)
    assert [stream.name for stream in found] == streams
    likely = sides_of(streams)
    assert tuple(likely[side][0] if len(likely[side]) == 1 else None for side in ("left", "right")) == sides
    for stream in found:
        assert stream_of(tmp_path, stream.name, "x").paths == stream.paths


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("../*.png", "is outside the drive folder"), ("*.png", "no file or folder"), ("mixed/*", "both videos and images"),
        ("linked", "is outside the drive folder"), ("linked/*.png", "is outside the drive folder"),
        ("gap/*", "chapter 2 of this"),
    ],
)  # fmt: skip
def test_names_of_streams_that_are_refused(name: str, says: str, tmp_path: Path) -> None:
    root = tmp_path / "run"
    for file in ("mixed/a.mp4", "mixed/a.png", "gap/GX010042.MP4", "gap/GX030042.MP4"):
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        (root / file).touch()
    (tmp_path / "out").mkdir()
    (tmp_path / "out/a.png").touch()
    (root / "linked").symlink_to(tmp_path / "out")
    with pytest.raises(InputError, match=says):
        stream_of(root, name, "drive.yaml")
