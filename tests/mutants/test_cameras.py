"""A second drive over standing cones whose cameras do not see what they should: no cone is removed, none is made up."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from pydantic import SecretStr

from conetl.db.connection import connect
from conetl.db.map.map_store import read_current_features
from conetl.model.errors import DriveFolderError
from conetl.model.health import Verdict
from conetl.model.ingest_report import TooManyRejectionsError
from conetl.model.map_records import DeltaKind
from conetl.pipeline.ingest import ingest
from conetl.pipeline.settings import Settings
from tests.cases import cases
from tests.conftest import cloned_database
from tests.integration.small_drives import SAMPLES, unpublished
from tests.mutants.images import copy_drive
from tests.mutants.table import RECORDINGS, SECOND

#: They would stand in a user's output.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
SECOND_DRIVE = {recording.name: recording.files for recording in RECORDINGS if SECOND in recording.on}
BLIND = ("left lens covered", "images x 0.06", "fog 0.9", "blur 8 px")
WRONG_SIDES = ("images mirrored", "images upside down")
FROZEN = ("both cameras frozen", "right camera frozen")


@pytest.fixture(scope="module")
def first_day(module_database_url: str, sample_settings: Settings) -> Settings:
    """A map of the first sample drive."""
    settings = sample_settings.model_copy(update={"database_url": SecretStr(module_database_url)})
    assert ingest(SAMPLES[0], settings=settings, publish_new=unpublished).counts[DeltaKind.ADDED] == 9
    return settings


@pytest.fixture
def settings(first_day: Settings, module_database_url: str, cluster_url: str) -> Iterator[Settings]:
    """The same map in a database of the test's own."""
    name = module_database_url.partition("@/")[2].partition("?")[0]
    with cloned_database(cluster_url, name) as url:
        yield first_day.model_copy(update={"database_url": SecretStr(url)})


def next_day(name: str, folder: Path) -> Path:
    """Every other pair of the first sample drive, recorded again a day later, and wrong.

    Some frames are 3 ms earlier: it is no copy.
    """
    files = SECOND_DRIVE[name]
    assert files is not None
    for file in copy_drive(SAMPLES[0], folder).glob("*/data/*"):
        if int(file.stem) % 2:
            file.unlink()
    files(folder)
    for path in folder.glob("*/timestamps.txt"):
        stamps = np.array(path.read_text().replace("2026-03-02", "2026-03-03").split("\n")[:-1], "datetime64[ns]")
        stamps[::3] -= np.timedelta64(3, "ms")
        path.write_text("".join(f"{stamp}\n".replace("T", " ") for stamp in stamps))
    return folder


def standing(settings: Settings) -> int:
    assert settings.database_url is not None
    with closing(connect(settings.database_url.get_secret_value())) as conn:
        return len(read_current_features(conn))


@pytest.mark.parametrize(
    ("name", "words"),
    cases(
        (BLIND[0], "too little detail"),
        *((name, "frame pairs") for name in FROZEN),
        release=[(name, "too little detail") for name in BLIND[1:]],
    ),
)
def test_cameras_that_see_nothing_or_are_frozen_change_nothing(
    settings: Settings, tmp_path: Path, name: str, words: str
) -> None:
    with pytest.raises(TooManyRejectionsError, match=words) as doubted:
        ingest(next_day(name, tmp_path / "2026-03-03_wrong"), settings=settings, publish_new=unpublished)
    counts = doubted.value.report.counts
    assert not counts[DeltaKind.REMOVED] and not counts[DeltaKind.ADDED] and not counts[DeltaKind.MOVED], counts
    assert standing(settings) == 9


def test_a_smeared_lens_removes_nothing_and_a_person_is_told(settings: Settings, tmp_path: Path) -> None:
    folder = next_day("lower part of both lenses smeared, 5 px", tmp_path / "2026-03-03_smeared")
    report = ingest(folder, settings=settings, publish_new=unpublished)
    [check] = [check for check in report.health if check.name == "blurred parts of the lenses"]
    assert check.verdict is Verdict.NOTE and "does not count as gone" in check.detail
    assert not report.counts[DeltaKind.REMOVED] and standing(settings) == 9


@pytest.mark.parametrize("name", cases(WRONG_SIDES[0], release=WRONG_SIDES[1:]))
def test_images_on_wrong_sides_are_refused(settings: Settings, tmp_path: Path, name: str) -> None:
    with pytest.raises(DriveFolderError, match="swapped, mirrored or upside down"):
        ingest(next_day(name, tmp_path / "2026-03-03_again"), settings=settings)
    assert standing(settings) == 9
