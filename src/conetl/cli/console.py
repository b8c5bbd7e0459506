"""What the commands share: tables, JSON, messages, progress bars, times and the log."""

from __future__ import annotations

import json
import logging
import math
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, is_dataclass
from datetime import UTC, date, datetime, timedelta
from enum import StrEnum
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any
from uuid import UUID

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from conetl.files.names import printable
from conetl.model.errors import ConetlError, InputError
from conetl.model.feature_classes import LANE_MARKING, noun_of
from conetl.model.health import HealthCheck, HeldDrive, HoldEvent, Verdict, hold_remedy

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on standard output.")]
ParamsOption = Annotated[
    Path | None, typer.Option("--params", help="YAML file of parameters; module conetl.model.params lists them.")
]
MapSridOption = Annotated[
    int | None, typer.Option("--map-srid", min=1, help="EPSG code of the map; default: the drive's UTM zone.")
]

MapOption = Annotated[
    str | None, typer.Option("--map", metavar="NAME", help="Name of the map; default: CONETL_MAP_NAME, or `default`.")
]
CategoryOption = Annotated[
    list[str] | None,
    typer.Option(
        "--category",
        help="Class to search for, such as drum or lane_marking, or `all`; may be repeated; default: traffic_cone.",
    ),
]
ClassesOption = Annotated[
    list[str] | None,
    typer.Option("--category", help="Only objects of this class, such as drum; may be repeated; default: all."),
]
#: State of the road; `map picture` has an older name for it, too.
AS_OF = "State of the road at this time, e.g. 2026-03-02 or 2026-03-02T10:00+01:00; default: latest."
AsOfOption = Annotated[str | None, typer.Option("--as-of", help=AS_OF)]
HeightsOption = Annotated[
    str | None, typer.Option(help="Heights of the file: ellipsoidal (default), or a system like EPSG:5773.")
]
SurveySigmaOption = Annotated[
    float | None,
    typer.Option(min=0, help="Sigma of the survey in m, if the file has no sigma_e_m, sigma_n_m, sigma_u_m."),
]
WithinOption = Annotated[
    float, typer.Option(min=0.01, help="Match a cone to a point if it is at most this far away, in metres.")
]
FileCrsOption = Annotated[
    str | None,
    typer.Option("--crs", help="CRS of the file, if it states none, e.g. EPSG:25832 or EPSG:25832+7837."),
]
DecisionsOption = Annotated[
    bool,
    typer.Option(
        "--decisions",
        help="Enable decisions in the map viewer (suppress, pin, revert). They require the writer token, which is created in "
        "CONETL_HOME.",
    ),
]
#: Knowledge right after each state, before later drives, decisions and corrections.
THEN = "then"
KnownOption = Annotated[
    str | None,
    typer.Option(
        "--known-at", "--believed-at",
        help=f"As known at this time, or `{THEN}`: before later drives and decisions; default: as known now.",
    ),
]  # fmt: skip

#: Heading of a column -> attribute of the record (of a row of the database: column), or function of the record.
Columns = Mapping[str, str | Callable[[Any], object]]
_ANY_WIDTH = 100_000


class _Console(Console):
    """Prints texts as they are: no markup, no emoji for :0:, and no character that moves a terminal's cursor."""

    def __init__(self, **options: Any) -> None:
        super().__init__(emoji=False, highlight=False, markup=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(printable(text, lines=True), **options)


class _Formatter(logging.Formatter):
    """The same of the log."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record), lines=True)


#: Columns of text, wherever they are.
_TEXT_COLUMNS = frozenset({"class", "paint", "pattern"})
out = _Console(soft_wrap=True)
#: Progress and messages go to standard error: standard output is for results.
err = _Console(stderr=True)


def start_logging(verbosity: int) -> None:
    """Log conetl to standard error: INFO at 1 (-v), DEBUG at 2 (-vv), at 0 what the database warns of.

    Other warnings are in the answers of commands.
    """
    log = logging.getLogger("conetl")
    log.handlers = [logging.NullHandler()]
    handler = RichHandler(console=err, show_path=verbosity > 1) if err.is_terminal else logging.StreamHandler()
    handler.setFormatter(_Formatter("%(message)s" if err.is_terminal else "%(asctime)s %(levelname)s %(message)s"))
    logging.getLogger("conetl" if verbosity else "conetl.db").handlers = [handler]
    log.setLevel((logging.WARNING, logging.INFO, logging.DEBUG)[min(verbosity, 2)])


def say(text: object = "", *, bold: str = "") -> None:
    """One line on standard output, `bold` first."""
    out.print(_labelled(bold, "bold", text) if bold else text)


def _labelled(label: str, style: str, text: object) -> Text:
    return Text.assemble((printable(label, lines=True), style), printable(str(text), lines=True))


def print_json(value: Any) -> None:
    """One JSON document on standard output; records become objects, other values text."""
    json.dump(value, sys.stdout, indent=2, default=_json_value)
    sys.stdout.write("\n")


def _json_value(value: Any) -> Any:
    if hasattr(value, "model_dump"):  # a pydantic model
        return value.model_dump(mode="json")
    if isinstance(value, datetime):
        return value.isoformat().replace("+00:00", "Z")  # as in the models
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else str(value)


def answer(as_json: bool, value: Any, text: str) -> None:
    """The result of a command: as JSON, or as one line of text."""
    if as_json:
        print_json(value)
    else:
        say(text)


def complain(error: ConetlError | str) -> None:
    """One error on standard error."""
    err.print(_labelled("conetl:", "bold red", f" {error}"), soft_wrap=True)


def note(*texts: str) -> None:
    """Remarks on standard error, a line each."""
    for text in texts:
        err.print(_labelled("conetl: note:", "yellow", f" {text}"), soft_wrap=True)


def note_unmeasured(card: Any) -> None:
    """Remark that the scores of a model (ModelCard) were never calibrated, where that is so."""
    if card.evidence is None:
        from conetl.perception.model_card import NOT_MEASURED  # pydantic takes half a second to load

        note(f"{card.name}: {NOT_MEASURED}")


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], *, numbers_from: int = 1) -> None:
    """A table on standard output: nothing without rows, no empty columns.

    Columns from `numbers_from` on are aligned right, but for `_TEXT_COLUMNS`.
    """
    cells = [[cell(value) for value in row] for row in rows]
    if not cells:
        return
    table = Table(title=title, title_justify="left", title_style="bold", header_style="bold", box=None, pad_edge=False)
    filled = [index for index in range(len(columns)) if any(row[index] for row in cells)]
    for index in filled:
        is_text = index < numbers_from or columns[index] in _TEXT_COLUMNS
        table.add_column(columns[index], justify="left" if is_text else "right", no_wrap=True)
    for row in cells:
        table.add_row(*(row[index] for index in filled))
    # As wide as necessary: a line may wrap in a terminal, but no number is ever cut off.
    # In a dumb terminal rich ignores a width without a height.
    wide = _Console(width=_ANY_WIDTH, height=1)
    _Console(width=Measurement.get(wide, wide.options, table).maximum, height=1).print(table)


def print_records(title: str, columns: Columns, records: Iterable[object], *, numbers_from: int = 1) -> None:
    """A table of records on standard output."""
    rows = [[_read(record, value) for value in columns.values()] for record in records]
    print_table(title, list(columns), rows, numbers_from=numbers_from)


def _read(record: Any, value: str | Callable[[Any], object]) -> object:
    if not isinstance(value, str):
        return value(record)
    return record[value] if isinstance(record, Mapping) else attrgetter(value)(record)


_NOT_PASSED = {
    Verdict.HOLD: "On hold", Verdict.NOTE: "Note", Verdict.WIDENED: "Widened", Verdict.CORRECTED: "Corrected",
}  # fmt: skip


def print_checks(checks: Sequence[HealthCheck]) -> None:
    """The health checks of a recording that did not pass, a line each."""
    for check in checks:
        if verdict := _NOT_PASSED.get(check.verdict):
            say(f", {check.name}: {check.detail}", bold=verdict)


def print_all_checks(checks: Sequence[HealthCheck]) -> None:
    """Every health check that was made: those that passed in a table, the others with what to do."""
    columns: Columns = {
        "check": "name",
        "measured": lambda check: check.figures or "cannot be measured in this recording",
        "verdict": "verdict",
    }
    print_records("Health checks", columns, checks, numbers_from=len(columns))
    print_checks(checks)


def print_held(drives: Sequence[HeldDrive], map_name: str) -> None:
    """Drives of a map on hold: check, what was measured, and what to do."""
    rows = [(drive, check) for drive in drives for check in drive.checks]
    columns: Columns = {
        "no": lambda row: row[0].changeset_no,
        "drive": lambda row: row[0].drive_id,
        "since (UTC)": lambda row: row[0].since,
        "check": lambda row: row[1].name,
        "measured": lambda row: row[1].figures,
    }
    if rows:
        print_records(f"On hold: {counted(len(drives), 'drive')}", columns, rows, numbers_from=len(columns))
        for drive in drives:
            say(f"{drive.drive_id}: {drive.reason} {hold_remedy(drive.changeset_no, map_name)}")


def print_hold_events(events: Sequence[HoldEvent]) -> None:
    """Holds and releases, in order."""
    columns: Columns = {"time (UTC)": "at", "no": "changeset_no", "drive": "drive_id", "holds and releases": "sentence"}
    print_records("", columns, events, numbers_from=len(columns))


def cell(value: object) -> str:
    """A value as it is printed in tables: ids cut short, times in UTC to the second, numbers with three decimals."""
    match value:
        case None:
            return ""
        case float():
            return f"{value:.3f}"
        case datetime():
            return f"{value.astimezone(UTC):%Y-%m-%d %H:%M:%S}"
        case UUID():
            return str(value)[:8]
        case StrEnum():
            return value.replace("_", " ")
        case _:
            return str(value)


@contextmanager
def progress_bar(description: str, unit: str) -> Iterator[Callable[..., None]]:
    """A progress bar on standard error, if that is a terminal; yields `update(done, total, description=...)`.

    It appears with the first update, and leaves nothing behind. unit: what is counted, for example "images".
    """
    columns = (
        TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.fields[counts]}"), TimeElapsedColumn(),
        TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=err, disable=not err.is_terminal, transient=True, redirect_stdout=False) as bars:
        task = bars.add_task(description, total=None, visible=False, counts="")

        def update(done: int, total: int | None, **changed: Any) -> None:
            counts = f"{done:,}" if total is None else f"{done:,}/{total:,}"
            bars.update(task, completed=done, total=total, visible=True, counts=f"{counts} {unit}", **changed)

        yield update


@contextmanager
def at_a_question() -> Iterator[None]:
    """Ctrl-C ends the program at once while a question waits for its answer: no step is running."""
    earlier = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, earlier)


@contextmanager
def spinner(text: str) -> Iterator[Callable[[str], object]]:
    """A spinner with a text on a terminal; yields the function that changes the text."""
    if not err.is_terminal:
        yield lambda _text: None
        return
    with err.status(Text(printable(text))) as status:
        yield lambda now: status.update(Text(printable(now)))


def counted(count: int, noun: str, ending: str = "s") -> str:
    """`1 cone`, `2 cones`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}{ending}"


def counted_by_reason(reasons: Iterable[tuple[str, int]]) -> str:
    """`box cut by border: 9, existence unlikely: 2`."""
    return ", ".join(f"{reason.replace('_', ' ')}: {count}" for reason, count in reasons)


def counted_by_class(classes: Mapping[str, int]) -> str:
    """By category: `1 drum, 2 cones, 3 stretches of lane markings`; of nothing `0 cones`."""
    nouns = (
        counted(count, noun_of(name)) if name != LANE_MARKING else f"{counted(count, 'stretch', 'es')} of lane markings"
        for name, count in sorted(classes.items())
    )
    return ", ".join(nouns) or counted(0, "cone")


def parse_size(
    option: str,
    text: str | None,
    unit: str,
    low: float,
    high: float,
    example: str,
    number: Callable[[str], float] = float,
) -> tuple[Any, Any] | None:
    """Width and height like 240x160, each from low to high. Raises InputError."""
    if text is None:
        return None
    try:
        width, height = (number(part) for part in text.strip().lower().split("x"))
    except ValueError:
        width = height = math.nan
    if not (low <= width <= high and low <= height <= high):
        raise InputError(
            f"{option} {text}: expected width x height in {unit}, {low:g} to {high:g} each, like {example}"
        )
    return width, height


def parse_known(known_at: str | None, valid_at: datetime | None) -> datetime | None:
    """The instant of the database of `KnownOption`; valid_at: time on the road, which `then` means. Raises InputError."""
    if known_at == THEN and valid_at is None:
        raise InputError(f"--known-at {THEN} requires a time on the road: give --as-of")
    return valid_at if known_at == THEN else parse_instant(known_at)


def known_text(known_at: str | None) -> str:
    """`as known now`, or which earlier knowledge is shown."""
    return "as known now" if known_at is None else "as known then" if known_at == THEN else f"as known at {known_at}"


def parse_instant(text: str | None) -> datetime | None:
    """ISO 8601 date or time; UTC unless it names a zone. A date is its whole day: as an instant, the last microsecond of it.

    Raises InputError.
    """
    return _parse_time(text, at_end=True)


def parse_span(begin: str | None, end: str | None, options: tuple[str, str]) -> tuple[datetime | None, datetime | None]:
    """Begin and end of a span, as `parse_instant`; a date at its begin or end belongs to it. options: the names of both.

    Raises InputError if it ends before it begins.
    """
    since, until = _parse_time(begin, at_end=False), _parse_time(end, at_end=True)
    if since is not None and until is not None and until < since:
        raise InputError(f"{options[1]} {end} is before {options[0]} {begin}: exchange them")
    return since, until


def _parse_time(text: str | None, *, at_end: bool) -> datetime | None:
    if text is None:
        return None
    try:
        if re.fullmatch(r"\d{4}-?W\d\d", text.strip()):
            raise ValueError("a week is no date")
        time = datetime.fromisoformat(text.strip())
        day = timedelta(days=1, microseconds=-1) if at_end and is_date(text) else timedelta()
        return (time if time.tzinfo else time.replace(tzinfo=UTC)) + day
    except (ValueError, OverflowError):
        raise InputError(f"invalid time {text!r}: use for example 2026-03-02 or 2026-03-02T10:00:00+01:00") from None


def is_date(text: str) -> bool:
    """Whether the text is a date without a time, in any form of ISO 8601."""
    try:
        date.fromisoformat(text.strip())
    except ValueError:
        return False
    return True
