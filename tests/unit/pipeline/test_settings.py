from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conetl.model.errors import InputError
from conetl.model.map_records import MAP_NAME
from conetl.pipeline.settings import Settings, ignored_variables, prefect_environment, read_settings, validated_map_name
from tests.command import ROOT, conetl


def test_the_environment_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CONETL_MAP_NAME", "north")
    monkeypatch.setenv("CONETL_DATABASE_URL", "postgresql://me:geheim@host/db")
    settings = read_settings()
    assert settings.map_name == "north"
    assert "geheim" not in settings.model_dump_json()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("CONETL_MAP_NAME", "Bad Name"),
        ("CONETL_WORKERS", "0"),
        ("CONETL_EMBED_HOST", "https://intranet.example; script-src *"),
        ("CONETL_EMBED_HOST", "*"),
    ],
)
def test_a_variable_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=name):
        read_settings()


@given(st.text(max_size=60).filter(lambda name: not MAP_NAME.fullmatch(name)))
def test_a_refused_map_name_comes_with_one_that_is_accepted(name: str) -> None:
    with pytest.raises(InputError) as refused:
        validated_map_name(name)
    validated_map_name(str(refused.value).rpartition("for example ")[2])


def test_variables_that_nothing_reads_are_named() -> None:
    done = conetl("rig", "show", "none.yaml", CONETL_MODEL="mine.onnx", CONETL_UNHEARD_OF=1)
    assert "CONETL_MODEL (did you mean CONETL_MODEL_PATH?), CONETL_UNHEARD_OF\n" in done.stderr
    assert "ignored" not in conetl("rig", "show", "none.yaml", CONETL_MODEL_PATH="mine.onnx").stderr
    kubernetes = [
        "CONETL_VIEW_SERVICE_HOST",
        "CONETL_PORT",
        "CONETL_PORT_8080_TCP_ADDR",
        "CONETL_VIEW_SERVICE_PORT_HTTP",
    ]
    files = [
        ROOT / "compose.yaml",
        *(p for name in ("tests", "benchmarks", "flows") for p in (ROOT / name).rglob("*.py")),
    ]
    used = {
        name for file in files if file != Path(__file__) for name in re.findall(r"\bCONETL_[A-Z_]+\b", file.read_text())
    }
    assert len(used) > 15 and ignored_variables([*used, *kubernetes, "PREFECT_HOME"]) == []


def test_what_is_told_of_a_drive_on_one_map_does_not_replace_what_is_told_of_it_on_another() -> None:
    """The same drive is new on one map and confirms another."""
    here, there = (Settings(map_name=name) for name in ("demo", "test"))
    assert here.drive_image_path("../d 1") != there.drive_image_path("../d 1")
    assert here.drive_image_path("../d 1").parent == here.drive_report_path("../d 1", 1).parent == here.reports_folder


def test_what_conetl_logs_is_among_the_logs_of_its_runs(tmp_path: Path) -> None:
    """Without a level of its own a logger has the root's, which is WARNING by default: Prefect showed no log of a run."""
    code = """if True:
        import logging
        from prefect.logging.configuration import setup_logging
        from prefect.logging.handlers import APILogHandler
        setup_logging()
        log = logging.getLogger("conetl")
        print(log.isEnabledFor(logging.INFO), any(isinstance(handler, APILogHandler) for handler in log.handlers))"""
    environment = os.environ | prefect_environment(tmp_path)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "True True\n"


def test_runs_with_their_logs_and_artifacts_do_not_stay_for_ever(tmp_path: Path) -> None:
    code = """if True:
        from prefect.settings import get_current_settings
        vacuum = get_current_settings().server.services.db_vacuum
        print(sorted(vacuum.enabled_vacuum_types), vacuum.retention_period.days)"""
    environment = os.environ | prefect_environment(tmp_path)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == "['events', 'flow_runs', 'orphans'] 90\n"
