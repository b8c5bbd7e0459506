"""`conetl simulate`: a drive with known truth, rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from conetl.cli.console import JsonOption, out, print_json, progress_bar


def simulate(
    folder: Annotated[Path, typer.Argument(help="Where to write the drive; must not exist or be empty.")],
    pass_number: Annotated[
        int, typer.Option("--pass", min=1, max=3, help="1 first survey, 2 next day, 3 opposite direction.")
    ] = 1,
    seed: Annotated[int, typer.Option(help="Noise of cameras and GNSS; equal seeds give equal drives.")] = 20260302,
    width: Annotated[int, typer.Option(min=64, help="Image width in pixels.")] = 960,
    height: Annotated[int, typer.Option(min=32, help="Image height in pixels.")] = 320,
    samples: Annotated[int, typer.Option(min=1, help="Light paths per pixel.")] = 9,
    base: Annotated[
        bool,
        typer.Option(
            "--base", help="Instead of a drive the base layers: the street's LiDAR points and lane boundaries."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Render a stereo drive along a lane-closure taper, with its truth.csv (needs the extra `simulate`)."""
    from conetl.simulation.simulate import simulate_drive

    if base:
        from conetl.simulation.base_layers import simulate_base_layers

        files = [str(path) for path in simulate_base_layers(folder, seed=seed)]
        if as_json:
            print_json({"base_layers": files})
        else:
            out.print(f"{' '.join(files)}: try `conetl base import {' '.join(files)}`", markup=False)
        return
    with progress_bar() as bars:
        bar = bars.add_task("render", total=None)
        written = simulate_drive(
            folder,
            pass_number=pass_number,
            seed=seed,
            width_px=width,
            height_px=height,
            samples_per_pixel=samples,
            progress=lambda done, total: bars.update(bar, completed=done, total=total),
        )
    if as_json:
        print_json({"drive": str(written)})
    else:
        out.print(f"{written}: try `conetl ingest {written}`", markup=False)
