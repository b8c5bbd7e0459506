"""A second drive over standing cones whose cameras do not see what they should: no cone is removed, none is made up."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import SecretStr

from conetl.db.connection import connect
from conetl.db.map.map_store import read_current_features
from conetl.model.errors import DriveFolderError
from conetl.model.ingest_report import TooManyRejectionsError
from conetl.model.map_records import DeltaKind
from conetl.pipeline.ingest import ingest
from conetl.pipeline.settings import Settings
from tests.integration.small_drives import SAMPLES

Image = NDArray[np.uint8]
Mutant = Callable[[Image, Image], tuple[Image, Image]]


def both(change: Callable[[Image], Image]) -> Mutant:
    return lambda left, right: (change(left), change(right))


def darker(share: float) -> Callable[[Image], Image]:
    return lambda image: (image * share).astype(np.uint8)


def foggier(share: float) -> Callable[[Image], Image]:
    return lambda image: (image * (1.0 - share) + 200.0 * share).astype(np.uint8)


def blurred(sigma_px: float) -> Callable[[Image], Image]:
    return lambda image: cv2.GaussianBlur(image, (0, 0), sigma_px).astype(np.uint8)


BLIND: dict[str, Mutant] = {
    "both covered": both(darker(0.0)),
    "left covered": lambda left, right: (darker(0.0)(left), right),
    "dark": both(darker(0.06)),
    "fog": both(foggier(0.9)),
    "thick fog": both(foggier(0.97)),
    "out of focus": both(blurred(8.0)),
}
WRONG_SIDES: dict[str, Mutant] = {
    "swapped": lambda left, right: (right, left),
    "mirrored": both(lambda image: np.ascontiguousarray(image[:, ::-1])),
    "upside down": both(lambda image: np.ascontiguousarray(image[::-1, ::-1])),
}


@pytest.fixture
def settings(database_url: str, tmp_path: Path) -> Settings:
    """A map of the first sample drive."""
    settings = Settings(home=tmp_path / "home", database_url=SecretStr(database_url), workers=2)
    assert ingest(SAMPLES[0], settings=settings).counts[DeltaKind.ADDED] == 9
    return settings


def next_day(folder: Path) -> Path:
    """The first sample drive, recorded again a day later."""
    shutil.copytree(SAMPLES[0], folder)
    for path in folder.glob("*/timestamps.txt"):
        path.write_text(path.read_text().replace("2026-03-02", "2026-03-03"))
    return folder


def mutate(folder: Path, mutant: Mutant) -> Path:
    for path in (folder / "image_02" / "data").iterdir():
        files = (path, folder / "image_03" / "data" / path.name)
        left, right = (np.asarray(cv2.imread(str(file)), np.uint8) for file in files)
        for file, image in zip(files, mutant(left, right), strict=True):
            cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return folder


def standing(settings: Settings) -> int:
    assert settings.database_url is not None
    with closing(connect(settings.database_url.get_secret_value())) as conn:
        return len(read_current_features(conn))


def test_cameras_that_see_nothing_remove_nothing(settings: Settings, tmp_path: Path) -> None:
    for number, (name, mutant) in enumerate(BLIND.items()):
        folder = mutate(next_day(tmp_path / f"2026-03-03_{number}"), mutant)
        with pytest.raises(TooManyRejectionsError, match="too little detail") as doubted:
            ingest(folder, settings=settings)
        counts = doubted.value.report.counts
        assert not counts[DeltaKind.REMOVED] and not counts[DeltaKind.ADDED] and not counts[DeltaKind.MOVED], (
            name,
            counts,
        )
        assert standing(settings) == 9, name


@pytest.mark.parametrize("name", WRONG_SIDES)
def test_images_on_wrong_sides_are_refused(settings: Settings, tmp_path: Path, name: str) -> None:
    with pytest.raises(DriveFolderError, match="swapped, mirrored or upside down"):
        ingest(mutate(next_day(tmp_path / "2026-03-03_again"), WRONG_SIDES[name]), settings=settings)
    assert standing(settings) == 9


@pytest.mark.parametrize("cameras", [("image_02", "image_03"), ("image_03",)])
def test_a_frozen_camera_changes_nothing(settings: Settings, tmp_path: Path, cameras: tuple[str, ...]) -> None:
    folder = next_day(tmp_path / "2026-03-03_frozen")
    for camera in cameras:
        first, *others = sorted((folder / camera / "data").iterdir())
        for path in others:
            shutil.copy(first, path)
    with pytest.raises(TooManyRejectionsError, match="frame pairs") as doubted:
        ingest(folder, settings=settings)
    counts = doubted.value.report.counts
    assert not counts[DeltaKind.REMOVED] and not counts[DeltaKind.ADDED], counts
    assert standing(settings) == 9
