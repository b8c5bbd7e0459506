"""One drive analysed with a progress bar: no server, no database, nothing is put on the map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from conetl.cli.console import note_unmeasured, progress_bar
from conetl.model.errors import InputError
from conetl.model.params import IngestParams
from conetl.perception.model_card import read_model_card
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive

if TYPE_CHECKING:  # loaded when needed: it imports the network's runtime
    from conetl.pipeline.analysis import AnalysedDrive


def analyse_folder(
    folder: Path, settings: Settings, params: IngestParams, *, map_srid: int | None = None
) -> AnalysedDrive:
    """Read and analyse one drive; results of finished chunks are kept as in an ingest. Raises ConetlError."""
    from conetl.pipeline.analysis import analyse

    if not folder.is_dir():
        raise InputError(f"no such drive folder: {folder}")
    drive, rejections = read_drive(folder, map_srid=map_srid, images_folder=settings.images_folder.resolve())
    note_unmeasured(read_model_card(settings.model_path))
    with progress_bar(drive.drive_id, "images") as update:
        return analyse(drive, params, rejections=rejections, settings=settings, progress=update)
