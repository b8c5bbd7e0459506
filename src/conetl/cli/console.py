"""What the commands share: printing tables, JSON and complaints."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from conetl.model.errors import ConetlError, InputError
from conetl.perception.model_card import NOT_MEASURED, ModelCard

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result as JSON on standard output, and nothing else there.")
]

_ANY_WIDTH = 100_000
out = Console(highlight=False, soft_wrap=True)
#: Progress and complaints go to standard error: standard output is for results.
err = Console(stderr=True, highlight=False)


def print_json(value: Any) -> None:
    """One JSON document on standard output."""
    json.dump(value, sys.stdout, indent=2, default=str)
    sys.stdout.write("\n")


def complain(error: ConetlError) -> None:
    """One complaint on standard error."""
    err.print(f"[bold red]conetl:[/] {_plain(str(error))}", soft_wrap=True)


def note_unmeasured(card: ModelCard) -> None:
    """One line on standard error where nobody measured what the model's scores mean."""
    if card.evidence is None:
        err.print(f"[yellow]conetl: note:[/] {card.name}: {NOT_MEASURED}", soft_wrap=True)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]], *, numbers_from: int = 1) -> None:
    """A table on standard output; columns from `numbers_from` on are aligned right."""
    table = Table(title=title, title_justify="left", title_style="bold", header_style="bold", box=None, pad_edge=False)
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index >= numbers_from else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(_plain(str(cell)) for cell in row))
    # As wide as it has to be: a line may wrap in a terminal, but no number is ever cut off.
    wide = Console(highlight=False, width=_ANY_WIDTH)
    Console(highlight=False, width=Measurement.get(wide, wide.options, table).maximum).print(table)


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A progress bar on standard error, silent where that is not a terminal."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, disable=not err.is_terminal, transient=True) as progress:
        yield progress


def _plain(text: str) -> str:
    return text.replace("[", "\\[")


def counted(count: int, noun: str) -> str:
    """`1 cone`, `2 cones`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def parse_time(text: str | None) -> datetime | None:
    """ISO 8601 date or time; UTC where it names no zone. Raises InputError."""
    if text is None:
        return None
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(f"{text!r} is no time: write it like 2026-03-02 or 2026-03-02T10:00:00+01:00") from None
    return time if time.tzinfo else time.replace(tzinfo=UTC)
