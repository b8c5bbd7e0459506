"""Times and tables of the command line."""

from __future__ import annotations

import io
import json
from datetime import UTC, datetime

import pytest
from rich.console import Console

from conetl.cli import console
from conetl.cli.console import parse_instant, parse_time, print_table
from conetl.model.errors import InputError


def test_a_day_is_its_first_instant_in_either_form_of_iso_8601():
    assert parse_time("2026-03-02") == parse_time("20260302") == datetime(2026, 3, 2, tzinfo=UTC)


def test_an_instant_of_a_day_is_its_end():
    end = datetime(2026, 3, 2, 23, 59, 59, 999999, tzinfo=UTC)
    assert parse_instant("2026-03-02") == parse_instant("20260302") == end
    assert parse_instant("2026-03-02T10:00") == parse_time("2026-03-02T10:00") and parse_instant(None) is None


def test_times_in_json_have_the_form_of_the_models(capsys):
    console.print_json({"at": datetime(2026, 3, 2, 10, tzinfo=UTC)})
    assert json.loads(capsys.readouterr().out) == {"at": "2026-03-02T10:00:00Z"}


@pytest.mark.parametrize("text", ["2026", "1772352000", "1772352000.5", "0", "2026-03", "yesterday", ""])
def test_a_number_is_not_a_time(text):
    """2026 is not meant as seconds since 1970."""
    with pytest.raises(InputError, match="invalid time"):
        parse_time(text)


def test_table_cells_are_never_cut_off(capsys):
    names = ", ".join(f"{number:04d}_migration" for number in range(40))
    print_table("", ("property", "value"), [("applied migrations", names), ("user", "[conetl]")], numbers_from=9)
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert f"applied migrations  {names}" in lines
    assert "user                [conetl]" in lines


def test_columns_without_a_value_are_left_out(capsys):
    print_table("", ("feature", "missed", "shift m"), [("a", None, 0.5), ("b", "", None)])
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [
        ["feature", "shift", "m"],
        ["a", "0.500"],
        ["b"],
    ]


def test_a_bar_counts_in_its_unit_and_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither `0/?`, nor a summary on the line of the bar."""
    screen = io.StringIO()
    monkeypatch.setattr(console, "err", Console(file=screen, force_terminal=True, width=100))
    with console.progress_bar("drive", "images") as update:
        update(0, None)
        update(461, 461)
    shown = screen.getvalue()
    assert "461/461 images" in shown and "?" not in shown.replace("\x1b[?25", "")
    assert shown.endswith("\x1b[2K"), "the line is erased, and the cursor stands at its beginning"
    done = shown.rsplit("\r", 1)[0]
    assert "461/461" in done


def test_no_cell_is_cut_off_in_a_terminal_that_does_not_know_its_width(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "dumb")
    print_table("", ("name", "value"), [("a" * 70, "b" * 70)])
    assert "b" * 70 in capsys.readouterr().out
