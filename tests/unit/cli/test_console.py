"""Times and tables of the command line."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from conetl.cli.console import parse_time, print_table
from conetl.model.errors import InputError


def test_a_day_is_its_first_instant_in_either_form_of_iso_8601():
    assert parse_time("2026-03-02") == parse_time("20260302") == datetime(2026, 3, 2, tzinfo=UTC)


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
