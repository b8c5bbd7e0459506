"""`conetl train`: a model that was taught an operator's own images."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from conetl.cli import console as ui
from conetl.learning.new_model import train_model
from conetl.model.errors import EXIT_NEEDS_ATTENTION
from conetl.pipeline.settings import read_settings


def train(
    labels: Annotated[Path, typer.Argument(help="Folder of `conetl labels export` or `conetl labels import`.")],
    output: Annotated[
        Path, typer.Option("--out", help="Model to write; its sidecar and a page are written beside it.")
    ] = Path("taught.onnx"),
    minutes: Annotated[float, typer.Option(min=0.5, max=1440, help="Time for all of it.")] = 12.0,
    model: Annotated[
        Path | None, typer.Option(help="Model to start from; default: CONETL_MODEL_PATH or the shipped one.")
    ] = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Teach the detector your own images, and compare it with the one before (requires the extra `train`).

    Some recordings are kept out to measure on. The new model is not installed: set CONETL_MODEL_PATH to use it. Exit code 1: some
    labels could not be used, or its scores could not be measured.
    """
    settings = read_settings()
    with ui.progress_bar("train", "%") as update:
        made = train_model(
            labels, output, base=model or settings.model_path, minutes=minutes, threads=settings.workers,
            progress=lambda share, text: update(round(100 * share), 100, description=text),
        )  # fmt: skip
    if as_json:
        about = {name: getattr(made, name) for name in ("trained_on", "kept_out", "evidence", "is_measured")}
        figures = [row._asdict() for row in made.comparison.figures]
        files = {"model": str(made.model), "page": str(made.page), "minutes": round(made.minutes, 1)}
        ui.print_json(files | about | {"figures": figures, "not_used": [one._asdict() for one in made.unusable]})
    else:
        columns: ui.Columns = {
            "images": "images", "class": "category", "objects": "objects", "score": "score",
            "recall old": lambda row: row.recall[0], "new": lambda row: row.recall[1],
            "false boxes per image old": lambda row: row.false_boxes[0], "new ": lambda row: row.false_boxes[1],
        }  # fmt: skip
        ui.print_records(f"Kept out: {', '.join(made.kept_out[:6])}", columns, made.comparison.figures, numbers_from=2)
        ui.say(f"-> {made.model}, {made.page}; to use it: CONETL_MODEL_PATH={made.model}")
        ui.print_records("Left out", {"record": "record", "reason": "reason"}, made.unusable[:20], numbers_from=2)
        if not made.is_measured:
            ui.note(f"no evidence in its sidecar, so existence probabilities use default values: {made.evidence}")
    if made.unusable or not made.is_measured:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)
