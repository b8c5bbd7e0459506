from __future__ import annotations

import pytest

from conetl.errors import InputError
from conetl.settings import read_settings


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
