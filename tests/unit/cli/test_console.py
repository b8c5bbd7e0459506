"""Times and tables of the command line."""

from __future__ import annotations

import io
import json
import logging
from datetime import UTC, datetime, timedelta, timezone

import pytest
from rich.console import Console

from conetl.cli import console
from conetl.cli.console import parse_instant, parse_span, print_table
from conetl.files.names import printable
from conetl.model.errors import InputError
from conetl.model.health import HealthCheck, Verdict

#: One day in all forms of ISO 8601 (extended and basic, also by its week); the spaces are a user's.
DAYS = ("2026-03-02", "20260302", "2026-W10-1", "2026W101", " 2026-03-02 ")
MORNING, LAST = datetime(2026, 3, 2, tzinfo=UTC), datetime(2026, 3, 2, 23, 59, 59, 999999, tzinfo=UTC)
OPTIONS = ("--since", "--until")


@pytest.mark.parametrize("day", DAYS)
def test_a_day_as_an_instant_is_its_end_and_belongs_to_a_span_at_either_end(day):
    assert parse_instant(day) == LAST
    assert parse_span(day, day, OPTIONS) == (MORNING, LAST)


def test_a_time_is_itself_in_utc_unless_it_names_a_zone():
    for text, hour in (("2026-03-02T10:00", 10), ("2026-W10-1T10", 10), ("2026-03-02T10:00+01:00", 9)):
        assert parse_instant(text) == parse_span(text, None, OPTIONS)[0] == MORNING.replace(hour=hour)
    assert parse_instant("2026-03-02T00:00") == MORNING, "midnight is not its day"
    assert parse_instant(None) is None and parse_span(None, None, OPTIONS) == (None, None)


def test_a_span_that_ends_before_it_begins_is_refused_with_its_options():
    with pytest.raises(InputError, match=r"--until 2026-03-01 is before --since 2026-03-02: exchange them"):
        parse_span("2026-03-02", "2026-03-01", OPTIONS)
    assert parse_span("2026-03-02T10:00", "2026-03-02T10:00", OPTIONS) == (MORNING.replace(hour=10),) * 2


def test_times_in_json_have_the_form_of_the_models(capsys):
    console.print_json({"at": datetime(2026, 3, 2, 10, tzinfo=UTC)})
    assert json.loads(capsys.readouterr().out) == {"at": "2026-03-02T10:00:00Z"}


def test_times_in_tables_are_in_utc(capsys):
    print_table("", ("from (UTC)",), [(datetime(2026, 3, 2, 6, tzinfo=timezone(timedelta(hours=1))),)])
    assert capsys.readouterr().out.split() == ["from", "(UTC)", "2026-03-02", "05:00:00"]


@pytest.mark.parametrize("text", ["2026", "1772352000", "1772352000.5", "0", "2026-03", "9999-12-32", "yesterday", ""])
def test_a_number_is_not_a_time(text):
    """2026 is not meant as seconds since 1970."""
    with pytest.raises(InputError, match="invalid time"):
        parse_instant(text)
    with pytest.raises(InputError, match="invalid time"):
        parse_span(text, None, OPTIONS)


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


@pytest.mark.parametrize(
    "text", ["root:x:0:0", "[red]a[/]", "0:v:0", "[/b]", "a\x1b[31m\x1b]0;t\x07b", "\u202egpj.exe"]
)
def test_texts_of_others_are_printed_as_they_are(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    """No emoji, no markup, nothing that a terminal obeys."""
    shown = printable(text)
    console.say(text)
    console.say(text, bold=text)
    console.complain(text)
    console.note(text)
    console.print_table(text, (text,), [(text,)])
    console.print_checks([HealthCheck(name=text, verdict=Verdict.NOTE, value=None, detail=text)])
    console.start_logging(1)
    logging.getLogger("conetl").warning("%s", text)
    said = capsys.readouterr()
    assert said.out.replace(" ", "").count(shown.replace(" ", "")) == 8
    assert said.err.count(shown) >= 3
    assert "\x1b" not in said.out + said.err
