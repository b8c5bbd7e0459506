from __future__ import annotations

import pytest

from conetl.model.errors import InputError
from conetl.pipeline.settings import Settings, read_settings


def test_the_environment_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CONETL_MAP_NAME", "north")
    monkeypatch.setenv("CONETL_DATABASE_URL", "postgresql://me:geheim@host/db")
    settings = read_settings()
    assert settings.map_name == "north"
    assert "geheim" not in settings.model_dump_json()


@pytest.mark.parametrize(("name", "value"), [("CONETL_MAP_NAME", "Bad Name"), ("CONETL_WORKERS", "0")])
def test_a_variable_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=name):
        read_settings()


def test_what_is_told_of_a_drive_on_one_map_does_not_replace_what_is_told_of_it_on_another() -> None:
    """The same drive is new on one map and confirms another."""
    here, there = (Settings(map_name=name) for name in ("demo", "test"))
    assert here.drive_image_path("../d 1") != there.drive_image_path("../d 1")
    assert here.drive_image_path("../d 1").parent == here.drive_report_path("../d 1", 1).parent == here.reports_folder
