"""`conetl labels export|import`: labels out of a map's decisions, and from other tools."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from conetl.cli import console as ui
from conetl.cli.database import open_map
from conetl.learning.labels.folder import NOT_WRITTEN, LabelFormat, Unusable
from conetl.model.errors import EXIT_NEEDS_ATTENTION, InputError

#: Records that are printed; all are in the JSON and in the folder.
_SHOWN = 20


def export(
    folder: Annotated[Path, typer.Argument(help="Folder to write to; it must be new or empty.")],
    form: Annotated[LabelFormat, typer.Option("--format", help="Labels for other tools, beside the tables.")] = "yolo",
    frames: Annotated[int, typer.Option(min=1, max=1000, help="Frame pairs per decision and drive.")] = 6,
    map_name: ui.MapOption = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Write the images and boxes that people's decisions confirm, correct or refuse, for `conetl train` or a labelling tool.

    Images are whole, not pixelated. Each box has its decision. Exit code 1: some images are missing (the others are written).
    """
    from conetl.learning.labels.of_map import export_labels

    with open_map(map_name) as (conn, info):
        found = export_labels(conn, folder, map_name=info.map_name, frames=frames, form=form)
    counts = {
        "images": len(found.images),
        "boxes": len(found.boxes),
        "not_written": [one._asdict() for one in found.unusable],
    }
    if as_json:
        ui.print_json({"folder": str(folder)} | counts)
    else:
        judged = ui.counted_by_reason(
            (name, sum(one.origin == name for one in found.boxes)) for name in _kinds(found.boxes)
        )
        ui.say(
            f"{folder}: {ui.counted(len(found.images), 'image')}, {ui.counted(len(found.boxes), 'box', 'es')} ({judged})"
        )
    _finish(found.unusable, as_json)


def import_(
    source: Annotated[Path, typer.Argument(help="YOLO folder, or COCO file or its folder (CVAT, Label Studio).")],
    output: Annotated[Path, typer.Option("--out", help="Folder to write to; it must be new or empty.")],
    classes: Annotated[
        list[str] | None,
        typer.Option(
            "--class", metavar="THEIRS=OURS", help="A class of the file, like Leitkegel=traffic_cone; may be repeated."
        ),
    ] = None,
    as_json: ui.JsonOption = False,
) -> None:
    """Read labels of other tools into a folder for `conetl train`.

    Objects of the classes that have boxes must all have one. Records that cannot be used are named and left out. Exit code 1:
    there are some, or a class that the network does not know.
    """
    from conetl.learning.labels.foreign import import_labels

    named = dict(one.rpartition("=")[::2] for one in classes or ())
    if without := [one for one in classes or () if not all(one.rpartition("=")[::2])]:
        raise InputError(f"--class {without[0]}: expected THEIRS=OURS, like Leitkegel=traffic_cone")
    found = import_labels(source, output, named)
    if as_json:
        ui.print_json(
            {
                "folder": str(output), "images": len(found.images), "boxes": len(found.boxes), "unknown_classes": found.unknown,
                "not_used": [one._asdict() for one in found.unusable],
            }
        )  # fmt: skip
    else:
        ui.say(f"{output}: {ui.counted(len(found.images), 'image')}, {ui.counted(len(found.boxes), 'box', 'es')}")
        for name, count in found.unknown.items():
            boxes = ui.counted(count, "box", "es")
            ui.note(f"the network has no class {name!r}: nothing is taught at its {boxes}. --class {name}=OURS maps it")
    if found.unknown:
        _finish(found.unusable, as_json, attention=True)
    _finish(found.unusable, as_json)


def _kinds(boxes: Sequence[object]) -> list[str]:
    return sorted({getattr(box, "origin", "") for box in boxes})


def _finish(unusable: Sequence[Unusable], as_json: bool, *, attention: bool = False) -> None:
    """Name what was left out; exit code 1 where there is any."""
    if not as_json and unusable:
        ui.print_records("Left out", {"record": "record", "reason": "reason"}, unusable[:_SHOWN], numbers_from=2)
        if len(unusable) > _SHOWN:
            ui.say(f"... and {len(unusable) - _SHOWN} more; all are in {NOT_WRITTEN}.")
    if unusable or attention:
        raise typer.Exit(EXIT_NEEDS_ATTENTION)
