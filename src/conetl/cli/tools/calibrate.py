"""`conetl calibrate`: images or videos of a board -> rig.yaml with covariances."""

from __future__ import annotations

import hashlib
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from conetl.cli.console import JsonOption, err, parse_size, print_json, print_table, progress_bar, say
from conetl.files.documents import input_errors
from conetl.geometry.calibration.stereo_calibration import CHANGE_PAIRS, MODELS, BoardShape, calibrate_stereo, rig_of
from conetl.geometry.rectification import check_stereo_baseline
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError
from conetl.model.rejections import RejectionReason
from conetl.model.rig import SIDES
from conetl.perception.boards import images as board_images
from conetl.perception.boards.boards import Board, parse_board
from conetl.perception.boards.videos import find_videos, open_videos, pairs_in_videos
from conetl.perception.images import ImageFileError
from conetl.perception.video import Layout
from conetl.readers.rigs.rig_yaml import write_rig_yaml

#: Exit code 1 if a larger share of the images was rejected.
MAX_REJECTED_SHARE = 0.25


_SHAPES: tuple[BoardShape, ...] = ("flat", "free")
Pairing = Literal["folders", "even-odd"]


def calibrate(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER | LEFT.mp4 RIGHT.mp4",
            help="Folder with left/ and right/ (or see --pairing), or with two videos; or the videos themselves.",
        ),
    ],
    board: Annotated[
        str,
        typer.Option(
            help="chessboard:9x6:37.8mm (inner corners), charuco:11x8:30mm:22mm:5X5_100, aprilgrid:6x6:88mm:0.3."
        ),
    ],
    pairing: Annotated[
        Pairing, typer.Option(help="folders: left/ and right/; even-odd: even numbers left, the next ones right.")
    ] = "folders",
    left_pattern: Annotated[str | None, typer.Option(help="Names of the left images, e.g. 'left_*.png'.")] = None,
    right_pattern: Annotated[str | None, typer.Option(help="Names of the right images, e.g. 'right_*.png'.")] = None,
    layout: Annotated[Layout | None, typer.Option(help="Arrangement of both images in one video.")] = None,
    offset_s: Annotated[
        float | None,
        typer.Option(
            min=-3600,
            max=3600,
            help="Seconds to add to the times of the right video; default: estimated from the motion in both.",
        ),
    ] = None,
    lens: Annotated[
        Literal["auto", "none", "radial", "brown", "rational", "fisheye"],
        typer.Option(help="Lens model; auto: the one with the lowest BIC."),
    ] = "auto",
    board_shape: Annotated[
        Literal["auto", "flat", "free"],
        typer.Option(help="flat: as drawn; free: estimate its deformation; auto: by BIC."),
    ] = "auto",
    square_sigma_mm: Annotated[
        float, typer.Option(min=0.0, help="Sigma of the size of the squares (tags), which scales the baseline.")
    ] = 0.0,
    sensor_mm: Annotated[
        str | None, typer.Option(help="Sensor size, e.g. 23.5x15.6, to print values in millimetres.")
    ] = None,
    rig_id: Annotated[str | None, typer.Option(help="Name of the rig; default: a hash of the result.")] = None,
    output: Annotated[Path, typer.Option("--out", help="File to write.")] = Path("rig.yaml"),
    report: Annotated[Path | None, typer.Option(help="Folder for report.json and coverage.png.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate a stereo rig from images or videos of a chessboard, ChArUco board or AprilGrid.

    From videos it uses the frames in which nothing moves, so hold the board still for a second in each position. Lens model and
    board shape are selected by BIC. The standard deviations include errors that are correlated within a pair. Exit code 1: more
    than a quarter of the images were rejected (rig.yaml is written anyway).
    """
    # here: matplotlib takes half a second to load
    from conetl.reports.inspection_images import calibration_as_dict, write_calibration_report

    drawn = parse_board(board)
    sensor = parse_size("--sensor-mm", sensor_mm, "millimetres", 0.1, 200, "23.5x15.6")
    folder, videos = sources[0], _videos(sources, layout)
    filmed = _pairs_of_videos(videos, layout, offset_s) if videos else None
    pairs = _pairs(folder, pairing, left_pattern, right_pattern) if filmed is None else filmed
    with progress_bar("find corners", "images") as update:
        images = board_images.find_boards(pairs, drawn, progress=update)
    _check_found(images, drawn)
    with input_errors(folder):
        result = calibrate_stereo(
            drawn.points_m(), images.views, board_images.start_values(drawn.points_m(), images.views, images.sizes),
            models=tuple(model for model in MODELS if lens in ("auto", model)),
            board_shapes=tuple(shape for shape in _SHAPES if board_shape in ("auto", shape)),
        )  # fmt: skip
        check_stereo_baseline(result.bundle.left_SE3_right)
    name = rig_id or f"rig-{hashlib.sha256(repr(result.bundle).encode()).hexdigest()[:8]}"
    rig = rig_of(result, name, scale_sigma_relative=1e-3 * square_sigma_mm / drawn.size_m)
    misfits = [
        board_images.rejection(pairs[r.pair_index], r.side, RejectionReason.BOARD_MISFIT, r.detail)
        for r in result.rejected_views
    ]
    # A video also shows how the board is brought and taken away.
    empty = _without_board(images) if videos else frozenset()
    rejected = [*(r for r in images.rejections if r.payload["pair"] not in empty), *misfits]
    content = calibration_as_dict(rig, result, pairs, rejected, sensor)
    content["pairs"] -= len(empty)
    write_rig_yaml(rig, output)
    content["written"] = [str(output)]
    if report is not None:
        write_calibration_report(report, content, result)
    if as_json:
        print_json(content)
    else:
        _print(content)
    if len(rejected) > MAX_REJECTED_SHARE * 2 * content["pairs"]:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)


def _videos(sources: list[Path], layout: Layout | None) -> list[Path]:
    """The video files to read; none where the source is a folder of images. Raises InputError."""
    for source in sources:
        if not source.exists():
            raise InputError(f"{source}: no such folder or file")
    if len(sources) > 2 or (len(sources) == 2 and any(source.is_dir() for source in sources)):
        raise InputError("expected one folder, two video files (left, right), or one video file with --layout")
    found = sources if sources[0].is_file() else find_videos(sources[0], layout)
    if layout is not None and not found:
        raise InputError(f"{sources[0]}: --layout requires a video file")
    return found


def _pairs_of_videos(videos: list[Path], layout: Layout | None, offset_s: float | None) -> list[board_images.ImagePair]:
    opened = open_videos(videos, layout)
    with progress_bar("choose frames", "frames") as update:
        try:
            pairs, found_s = pairs_in_videos(opened, offset_s, on_frame=update)
        except ImageFileError as error:
            raise InputError(str(error)) from error
    err.print(f"{len(pairs)} frame pairs; time offset of the right video {found_s:+.2f} s")
    return pairs


def _without_board(images: board_images.BoardImages) -> frozenset[str]:
    """Names of the pairs of which neither image shows the board."""
    counted = Counter(r.payload["pair"] for r in images.rejections if r.reason is RejectionReason.BOARD_NOT_FOUND)
    return frozenset(str(name) for name, count in counted.items() if count == len(SIDES))


def _pairs(folder: Path, pairing: Pairing, left: str | None, right: str | None) -> list[board_images.ImagePair]:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    if (left is None) != (right is None):
        raise InputError("--left-pattern and --right-pattern must be used together")
    if left is not None and right is not None:
        return board_images.pairs_by_pattern(folder, left, right)
    return board_images.pairs_even_odd(folder) if pairing == "even-odd" else board_images.pairs_in_folders(folder)


def _check_found(images: board_images.BoardImages, board: Board) -> None:
    """Raise InputError if no image shows the board, with the most frequent reason."""
    if images.views:
        return
    details = Counter(r.detail for r in images.rejections).most_common(1)
    most = f"; most often: {details[0][0]} ({details[0][1]} images)" if details else ""
    raise InputError(f"the {board.kind} of {board.cols} x {board.rows} was not found in any image{most}. Check --board")


def _print(content: dict[str, Any]) -> None:
    used, rms, epipolar = content["pictures_used"], content["rms_px"], content["epipolar_error_px"]
    say(
        f"{content['pairs_used']} of {content['pairs']} pairs ({used['left']} left and {used['right']} right images), lens "
        f"{content['lens']}, board {content['board_shape']}."
    )
    say(f"RMS left {rms['left']:.3f} px, right {rms['right']:.3f} px, stereo {rms['stereo']:.3f} px")
    say(
        f"row difference after rectification: RMS {epipolar['rms']:.3f} px, 95 % within {epipolar['percentile_95']:.3f} px"
    )
    for key, unit in (("interior_mm", "millimetres"), ("interior_px", "pixels")):
        if key in content:
            rows = [_two(a, b) for a, b in zip(content[key]["left"], content[key]["right"], strict=True)]
            columns = ("", "unit", "left", "sigma", "right", "sigma")
            print_table(f"Interior orientation, {unit}", columns, rows, numbers_from=2)
    rows = [(r["name"], r["unit"], f"{r['value']:.4f}", f"{r['sigma']:.4f}") for r in content["relative"]]
    print_table("Relative orientation of the right camera", ("", "unit", "value", "sigma"), rows, numbers_from=2)
    models = [_model(c) for c in content["candidates"]]
    print_table("Models tried", ("lens", "board", "unknowns", "RMS px", "BIC"), models, numbers_from=2)
    if not content["constancy_checked"]:
        err.print(
            f"not checked: whether a camera was moved, zoomed or refocused between the pairs; this requires {CHANGE_PAIRS} pairs"
        )
    for side, share in content["coverage"].items():
        if share < 0.5:
            err.print(f"the board covers only {100 * share:.0f} % of the {side} image: also place it in the corners")
    for refused in content["rejections"]:
        say(f"not used: {refused['record']}: {refused['detail']}")
    if content["rejected_corners"]:
        say(f"not used: {len(content['rejected_corners'])} individual corners (listed in report.json)")
    for written in content["written"]:
        say(f"-> {written}")


def _two(left: dict[str, Any], right: dict[str, Any]) -> tuple[object, ...]:
    digits = 4 if left["unit"] else 6
    numbers = (left["value"], left["sigma"], right["value"], right["sigma"])
    return (left["name"], left["unit"], *(f"{value:.{digits}f}" for value in numbers))


def _model(tried: dict[str, Any]) -> tuple[object, ...]:
    result = ("-", tried["problem"]) if tried["bic"] is None else (tried["rms_px"], f"{tried['bic']:.1f}")
    return (tried["model"], tried["board"], tried["parameters"], *result)
