"""The plan of a backfill: which drives to ingest, why, the expected duration, which are already on the map, and what is no drive.

A drive is identified by its header (`readers/drives/header.py`), so no image is read. The exact content is compared when the
drive is ingested; a drive that turns out to be on the map changes nothing.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal
from uuid import UUID

from conetl.db.connection import Connection
from conetl.db.map.decision_store import held_drives
from conetl.db.map.map_store import list_changesets
from conetl.db.map.results import CommittedChangeset
from conetl.db.receipt_store import STRAYS, Receipt, headers_by_changeset, held_locks, latest_receipts, pairs_per_second
from conetl.files.atomic import write_json
from conetl.files.names import printable
from conetl.model.errors import InputError
from conetl.model.health import HeldDrive
from conetl.model.params import IngestParams
from conetl.pipeline.chunks import Analysis, analysis_of
from conetl.pipeline.entries import Entry, find_entries, quoted
from conetl.pipeline.settings import Settings
from conetl.readers.drives.header import DriveHeader

#: After this many starts, scheduled runs do not try again.
MAX_ATTEMPTS = 3
#: For so long a run whose process died is started again by the deployment `recover`; afterwards its drive is planned anew.
RECOVERED_FOR = timedelta(hours=1)
Action = Literal["ingest", "wait", "skip", "refuse", "needs init", "not recognised"]
_ON_HOLD = "on hold since"


@dataclass(frozen=True)
class PlanLine:
    """What to do with one entry. `wait`: another process ingests it, or it is arriving; `refuse`: the drive cannot be used."""

    header: DriveHeader
    action: Action
    why: str
    starts: int = 0
    """How often work on it was started before."""
    command: str = ""
    """What a person can do, as a line for a shell."""
    needs_attention: bool = False
    is_reported: bool = False
    """An earlier run has written its receipt, and nothing has changed."""

    @property
    def is_stray(self) -> bool:
        """It is no drive, or not yet."""
        return self.action in STRAYS

    @property
    def reason(self) -> str:
        """What it is, why, and the command."""
        text = f"{self.action}: {self.why}" if self.is_stray else self.why
        return f"{text}: {self.command}" if self.command and self.command not in text else text


@dataclass(frozen=True)
class Plan:
    """What to do with the drives below a folder, in the order of recording."""

    root: Path
    map_name: str
    since: datetime | None
    until: datetime | None
    analysis: Analysis
    lines: tuple[PlanLine, ...]
    pairs_per_second: float | None
    """Of drives that were committed before, one at a time; None where none was timed."""
    made_at: datetime
    seconds: float
    """How long making the plan took."""

    def count(self, action: Action) -> int:
        return sum(line.action == action for line in self.lines)

    @property
    def todo(self) -> list[PlanLine]:
        """The drives to process; those that another process ingests come last."""
        lines = [line for line in self.lines if line.action in ("ingest", "wait")]
        return sorted(lines, key=lambda line: line.action == "wait")

    @property
    def refused(self) -> list[PlanLine]:
        """Drives that cannot be used."""
        return [line for line in self.lines if line.action == "refuse"]

    @property
    def strays(self) -> list[PlanLine]:
        """What is no drive and was not reported before."""
        return [line for line in self.lines if line.is_stray and not line.is_reported]

    @property
    def has_news(self) -> bool:
        """Something is to be done, or to be reported."""
        return bool(self.todo or self.refused or self.strays)

    @property
    def open_lines(self) -> list[PlanLine]:
        """What needs attention, also since earlier runs."""
        return [line for line in self.lines if line.needs_attention]

    @property
    def frame_pairs(self) -> int:
        return sum(line.header.frame_pairs for line in self.lines if line.action == "ingest")

    def estimate_s(self, parallel: int) -> float | None:
        """Expected duration of the work; None if no throughput was measured yet."""
        return None if self.pairs_per_second is None else self.frame_pairs / self.pairs_per_second / max(1, parallel)


def plan_drives(
    conn: Connection,
    root: Path,
    *,
    settings: Settings,
    params: IngestParams,
    since: datetime | None = None,
    until: datetime | None = None,
    once: bool = False,
    recheck: bool = False,
    reanalyse: bool = False,
    entries: Iterable[Entry] | None = None,
) -> Plan:
    """Plan everything below `root`: the drives that were recorded in [since, until), and what is no drive.

    once: skip what failed for good or crashed repeatedly until it changes (for schedules). recheck: also compare the content of
    drives whose header is known. reanalyse: also drives that another version of conetl analysed. entries: what is below `root`,
    if it is known already. Raises InputError if `since` is not before `until`, or `root` is missing.
    """
    if since is not None and until is not None and until <= since:
        raise InputError(
            f"--until ({until:%Y-%m-%d %H:%M} UTC) must be later than --since ({since:%Y-%m-%d %H:%M} UTC)"
        )
    started = time.monotonic()
    if entries is None:
        entries = find_entries(root, settings=settings)
    found = [(entry, _header(entry, settings)) for entry in entries]
    found = [(entry, header) for entry, header in found if _is_within(header, since, until)]
    headers = [header for _, header in found]
    analysis = analysis_of(params, settings)
    receipts = latest_receipts(conn, map_name=settings.map_name, headers=[o.header_sha256 for o in headers])
    locked = held_locks(conn, [receipt.drive_lock for receipt in receipts.values() if receipt.state == "started"])
    on_hold = {drive.changeset_no: drive for drive in held_drives(conn, map_name=settings.map_name)}
    known: dict[str, list[CommittedChangeset]] = {}
    for changeset in reversed(list_changesets(conn, map_name=settings.map_name)):
        known.setdefault(changeset.drive_id, []).append(changeset)
    conn.rollback()
    folders_of = headers_by_changeset(conn, map_name=settings.map_name)
    lines: list[PlanLine] = []
    seen: dict[str, Path] = {}
    order = {"hidden": 2, "drive": 1}
    for entry, header in sorted(
        found, key=lambda o: (order.get(o[0].kind, 0), o[1].captured_from_ns or 0, str(o[1].path))
    ):
        receipt = receipts.get(header.header_sha256)
        if entry.kind in ("arriving", "hidden"):
            action, why = "wait" if entry.kind == "arriving" else "skip", entry.why
        elif header.header_sha256 in seen:
            action, why = "skip", f"the same recording as {printable(seen[header.header_sha256])}"
        else:
            action, why = _decide_action(
                header, receipt, known.get(header.drive_id, []), folders_of, analysis, on_hold,
                working=receipt is not None and receipt.drive_lock in locked, once=once, recheck=recheck,
                reanalyse=reanalyse,
            )  # fmt: skip
        seen.setdefault(header.header_sha256, header.path)
        lines.append(_line(entry, header, action, why, receipt))
    return Plan(
        root=root,
        map_name=settings.map_name,
        since=since,
        until=until,
        analysis=analysis,
        lines=tuple(lines),
        pairs_per_second=pairs_per_second(conn, map_name=settings.map_name),
        made_at=datetime.now(UTC),
        seconds=time.monotonic() - started,
    )


def _header(entry: Entry, settings: Settings) -> DriveHeader:
    """The header of an entry. A drive with a link that must not be followed is not opened."""
    try:
        if entry.kind == "drive":
            settings.require_readable(entry.path, links=True)
    except InputError as error:
        return replace(entry, kind="not recognised", why=str(error)).header()
    return entry.header()


def _line(entry: Entry, header: DriveHeader, action: str, why: str, receipt: Receipt | None) -> PlanLine:
    """The line of an entry, with what a person can do."""
    shown, command = quoted(header.path), entry.command
    failed = action == "skip" and receipt is not None and receipt.state in ("failed", "crashed")
    if entry.kind in STRAYS:
        action, why = entry.kind, entry.why
    elif action == "refuse":
        command = f"conetl inspect {shown}"
    elif entry.kind == "drive":
        command = "conetl drive held" if why.startswith(_ON_HOLD) else f"conetl ingest {shown}" if failed else ""
    person = failed or why.startswith(_ON_HOLD) or action in ("refuse", *STRAYS)
    return PlanLine(header, action, why, receipt.attempts if receipt else 0, command, person, failed)  # type: ignore[arg-type]


def _decide_action(
    header: DriveHeader,
    receipt: Receipt | None,
    on_map: Sequence[CommittedChangeset],
    folders_of: Mapping[UUID, set[str]],
    analysis: Analysis,
    on_hold: Mapping[int, HeldDrive],
    *,
    working: bool,
    once: bool,
    recheck: bool,
    reanalyse: bool,
) -> tuple[Action, str]:
    """What to do with one drive, and why. on_map: those with its id, oldest first; folders_of: header hashes by changeset."""
    if working and receipt is not None:
        return "wait", f"being ingested by {receipt.host} since {_when(receipt.at)}"
    same = receipt is not None and receipt.analysis_sha256 == analysis.sha256
    if receipt is not None and same and receipt.done:
        stored = next((drive for drive in on_map if drive.changeset_id == receipt.changeset_id), None)
        now = _present_state(stored, on_hold) if stored else f"on the map since {_when(receipt.at)}"
        return ("ingest", "to be compared again (recheck)") if recheck else ("skip", now)
    if receipt is not None and same and once and not receipt.may_pass and receipt.state == "failed":
        return "skip", f"failed on {_when(receipt.at)} and has not changed since: {receipt.reason}"
    if receipt is not None and same and once and receipt.attempts >= MAX_ATTEMPTS and not receipt.done:
        return "skip", f"tried {receipt.attempts} times; last: {receipt.reason or 'interrupted'}"
    if receipt is not None and same and once and receipt.state == "started" and _is_recent(receipt):
        return "skip", f"interrupted; `recover` starts it again ({_when(receipt.at)})"
    if header.problem is not None:
        return "refuse", header.problem
    if receipt is not None and same:
        what = "failed" if receipt.state == "failed" else "was interrupted"
        return "ingest", f"{what} on {_when(receipt.at)}" + (f": {receipt.reason}" if receipt.reason else "")
    found = [drive for drive in on_map if _is_same_recording(header, drive)]
    alike = [d for d in found if (d.params_sha256, d.model_sha256) == (analysis.params_sha256, analysis.model_sha256)]
    if alike:
        if recheck:
            return "ingest", "to be compared again (recheck)"
        # `conetl ingest` of 0.2.0 wrote no receipt, so the header is unknown: id and time have to do.
        same_folder = [
            d for d in alike if header.header_sha256 in folders_of.get(d.changeset_id, (header.header_sha256,))
        ]
        if not same_folder:
            return "ingest", f"changed since it was committed (changeset {alike[-1].changeset_no})"
        drive = same_folder[-1]
        if analysis.changeset_key(drive.content_sha256, drive.map_srid) != drive.idempotency_key and drive.counts:
            action = "replaces" if reanalyse else "--reanalyse replaces"
            why = f"analysed by another version: {action} changeset {drive.changeset_no}"
            return "ingest" if reanalyse else "skip", why
        # A person reverts a wrong delivery before its correction is ingested: without a receipt, this folder may be either.
        may_be_corrected = drive.changeset_id not in folders_of and not (drive.counts or drive.hold)
        return "ingest" if may_be_corrected else "skip", _present_state(drive, on_hold)
    if found or receipt is not None:
        return "ingest", "on the map, but analysed with other parameters or another model"
    return "ingest", "new"


def _is_recent(receipt: Receipt) -> bool:
    return receipt.at is not None and datetime.now(UTC) - receipt.at < RECOVERED_FOR


def _present_state(drive: CommittedChangeset, on_hold: Mapping[int, HeldDrive]) -> str:
    """What became of a drive that is stored."""
    no = drive.changeset_no
    if no in on_hold:
        return f"{_ON_HOLD} {_when(on_hold[no].since)} (changeset {no}; see `conetl drive held`)"
    if not drive.counts:
        return f"not in effect: changeset {no} was reverted or replaced (see `conetl map decisions`)"
    return f"on the map since {_when(drive.committed_at)} (changeset {no})"


def _is_same_recording(header: DriveHeader, drive: CommittedChangeset) -> bool:
    """By time: the recorded span contains that on the map, whose first and last pair may have been rejected."""
    if header.captured_from_ns is None or header.captured_to_ns is None:
        return False
    return header.captured_from_ns <= drive.captured_from_ns and drive.captured_to_ns <= header.captured_to_ns


def _is_within(header: DriveHeader, since: datetime | None, until: datetime | None) -> bool:
    """Whether a drive is in the period. Folders without a time always are, so that none is skipped silently."""
    at = header.captured_from
    return at is None or ((since is None or since <= at) and (until is None or at < until))


def _when(at: datetime | None) -> str:
    return f"{at:%Y-%m-%d %H:%M} UTC" if at else "just now"


def plan_as_dict(plan: Plan, parallel: int) -> dict[str, Any]:
    """The plan as JSON values."""
    return {
        "root": printable(plan.root),
        "map": plan.map_name,
        "since": plan.since and plan.since.isoformat(),
        "until": plan.until and plan.until.isoformat(),
        "params_sha256": plan.analysis.params_sha256,
        "model_sha256": plan.analysis.model_sha256,
        "made_at": plan.made_at.isoformat(),
        "planned_in_s": round(plan.seconds, 3),
        "entries": len(plan.lines),
        "drives": sum(not line.is_stray for line in plan.lines),
        "to_ingest": plan.count("ingest"),
        "waiting_for_others": plan.count("wait"),
        "not_usable": plan.count("refuse"),
        "needs_init": plan.count("needs init"),
        "not_recognised": plan.count("not recognised"),
        "need_attention": len(plan.open_lines),
        "nothing_to_do": plan.count("skip"),
        "frame_pairs": plan.frame_pairs,
        "pairs_per_second": plan.pairs_per_second,
        "estimated_s": plan.estimate_s(parallel),
        "max_parallel": parallel,
        "lines": [
            {
                "drive": line.header.shown_path,
                "drive_id": line.header.drive_id,
                "captured_from": line.header.captured_from and line.header.captured_from.isoformat(),
                "frame_pairs": line.header.frame_pairs,
                "header_sha256": line.header.header_sha256,
                "action": line.action,
                "why": line.why,
                "command": line.command or None,
                "needs_attention": line.needs_attention,
            }
            for line in plan.lines
        ],
    }


def write_plan(plan: Plan, parallel: int, folder: Path) -> Path:
    """Keep the plan as a file; returns its path."""
    path = folder / f"{plan.made_at:%Y%m%dT%H%M%S}-{plan.map_name}.json"
    write_json(path, plan_as_dict(plan, parallel))
    return path


def reason_counts(plan: Plan) -> list[tuple[str, int]]:
    """Number of drives for each action and kind of reason, the most frequent first."""
    words: dict[str, str] = {"ingest": "to ingest", "wait": "waiting", "skip": "nothing to do", "refuse": "not usable"}
    counted = Counter(
        f"{words.get(line.action, line.action)}: {line.why.split(':')[0].split(' on ')[0].split(' since ')[0]}"
        for line in plan.lines
    )
    return counted.most_common()


def attention_text(plan: Plan) -> str:
    """What needs attention, for the state of a run: how many of each kind, and the first with its reason; empty without any."""
    if not (lines := plan.open_lines):
        return ""
    lines.sort(key=lambda line: line.is_reported)
    kinds = Counter(line.action if line.is_stray else "failed or on hold" for line in lines)
    counts = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
    return f"; need attention: {counts}. {lines[0].header.drive_id}: {lines[0].reason}"


def drop_folder_rows(settings: Settings) -> list[dict[str, Any]]:
    """What is in the drop folder and no drive, or still arriving, as rows of a report: drive_id, drive_path, state, reason."""
    if not settings.inbox.is_dir():
        return []
    entries = find_entries(
        settings.inbox, may_be_drive=False, quiet_s=60.0 * settings.drop_quiet_minutes,
        settings=settings,
    )  # fmt: skip
    rows = []
    for entry in entries:
        if entry.kind not in ("drive", "hidden"):
            line = _line(entry, entry.header(), entry.kind, entry.why, None)
            shown = {"drive_id": line.header.drive_id, "drive_path": line.header.shown_path}
            rows.append(shown | {"state": entry.kind, "reason": line.reason})
    return rows
