"""`conetl simulate`: a rendered drive with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from conetl.cli.console import JsonOption, answer, progress_bar


def simulate(
    folder: Annotated[Path, typer.Argument(help="Folder to write to; it must be new or empty.")],
    pass_number: Annotated[
        int,
        typer.Option(
            "--pass", min=1, max=3, help="1: first survey, 2: next day, 3: third day (taper: opposite direction)."
        ),
    ] = 1,
    world: Annotated[
        Literal["taper", "mixed"],
        typer.Option(
            help="taper: a lane closure by cones; mixed: objects of all classes and several kinds of lane markings."
        ),
    ] = "taper",
    seed: Annotated[
        int, typer.Option(help="Seed of camera and GNSS noise, and of the objects and markings of the mixed world.")
    ] = 20260302,
    width: Annotated[int, typer.Option(min=64, help="Image width in pixels.")] = 960,
    height: Annotated[int, typer.Option(min=32, help="Image height in pixels.")] = 320,
    samples: Annotated[int, typer.Option(min=1, help="Light paths per pixel.")] = 9,
    base: Annotated[
        bool,
        typer.Option("--base", help="Write the base layers instead: LiDAR points and lane boundaries of the street."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Render a stereo drive through a work zone with ground truth (requires the extra `simulate`)."""
    from conetl.simulation.simulate import simulate_drive

    if base:
        from conetl.simulation.truth_files import simulate_base_layers

        files = [str(path) for path in simulate_base_layers(folder, seed=seed)]
        answer(as_json, {"base_layers": files}, f"{' '.join(files)}: try `conetl base import {' '.join(files)}`")
        return
    with progress_bar("render", "images") as update:
        written = simulate_drive(
            folder, pass_number=pass_number, seed=seed, world=world, width_px=width, height_px=height, samples_per_pixel=samples,
            progress=update,
        )  # fmt: skip
    answer(as_json, {"drive": str(written)}, f"{written}: try `conetl ingest {written}`")
