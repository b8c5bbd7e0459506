"""Lists of features and changes: filters, orders and pages as statements of `sql/lists.sql`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple
from uuid import UUID

from conetl.db.connection import Connection, database_errors, execute, load_sql
from conetl.model.feature_classes import FEATURE_CLASSES

Row = dict[str, Any]
#: Kinds in the order of lists: what matters most first.
KINDS = ("added", "split", "moved", "removed", "merged", "height_changed", "missed", "confirmed", "standing")


def _number_of(column: str, words: tuple[str, ...]) -> str:
    return f"array_position(array[{', '.join(map(repr, words))}], {column})"


#: What lists are sorted by -> the key, a float8 unless `_TYPES` says otherwise. Rows without a key come last in both directions.
ORDERS = {
    "id": "s.feature_id",
    "class": f"{_number_of('s.category', tuple(FEATURE_CLASSES))}::float8",
    "kind": f"{_number_of('s.kind', KINDS)}::float8",
    "existence": "s.existence_probability",
    "sigma": "s.sigma_m",
    "height": "s.object_height_m",
    # Moved ones, then what was added and removed, then the small shifts of confirmed ones.
    "shift": "case s.kind when 'moved' then 1e6 + s.shift_m when 'confirmed' then s.shift_m "
    f"else 1e3 - {_number_of('s.kind', KINDS)} end",
    "drive": "s.changeset_no::float8",
    "seen": "s.last_seen_at",
    "observations": "s.observation_count::float8",
    "east": "ST_X(s.geom)",
    "north": "ST_Y(s.geom)",
}  # fmt: skip
_TYPES = {"id": "uuid", "seen": "timestamptz"}
_MAY_BE_NULL = {"class", "height", "shift", "drive"}
#: Conditions of rows, by the parameter that each needs.
CONDITIONS = {
    "kinds": "s.kind = any(%(kinds)s)",
    "hidden_classes": "s.category <> all(%(hidden_classes)s)",
    "least_existence": "s.existence_probability >= %(least_existence)s",
    "most_existence": "s.existence_probability <= %(most_existence)s",
    "most_sigma_m": "s.sigma_m <= %(most_sigma_m)s",
    "least_height_m": "s.object_height_m >= %(least_height_m)s",
    "most_height_m": "s.object_height_m <= %(most_height_m)s",
    "of_changeset": "s.changeset_no = %(of_changeset)s",
    "seen_from": "s.last_seen_at >= %(seen_from)s",
    "seen_before": "s.last_seen_at < %(seen_before)s",
    "box": "s.geom && %(box)s::geometry and ST_Intersects(s.geom, %(box)s::geometry)",
}


class ListOrder(NamedTuple):
    """An order of a list. Of equal keys, the row that was written first comes first."""

    by: str
    """Of `ORDERS`."""
    descending: bool = False

    @property
    def key(self) -> str:
        if self.by not in _MAY_BE_NULL:
            return ORDERS[self.by]
        return f"coalesce({ORDERS[self.by]}, '{'-' if self.descending else ''}infinity')"

    def after(self, name: str) -> str:
        """Condition of the rows after that of the parameters NAME_key and NAME_row."""
        key = f"%({name}_key)s::{_TYPES.get(self.by, 'float8')}"
        sign = "<" if self.descending else ">"
        return f"({self.key} {sign}= {key} and ({self.key} {sign} {key} or s.version_row_id > %({name}_row)s))"


@dataclass(frozen=True)
class Listed:
    """Rows of a statement of `sql/lists.sql`, by its name, with its parameters and those of `CONDITIONS`."""

    source: str
    parameters: Mapping[str, Any]
    filters: Mapping[str, Any]

    def sql(self, statement: str, *, where: str = "true", texts: Mapping[str, str] | None = None) -> str:
        """A statement about these rows. where: another condition; texts: SQL for the other placeholders of the statement."""
        conditions = " and ".join([*(CONDITIONS[name] for name in self.filters), where])
        found = load_sql(f"lists.{statement}")
        source = load_sql(f"lists.{self.source}").rstrip(";")
        for name, text in {"source": source, "where": conditions, **(texts or {})}.items():
            found = found.replace("{{" + name + "}}", text)
        return found

    def values(self, **more: Any) -> dict[str, Any]:
        """The parameters of its statements."""
        return {"box": None, **self.parameters, **self.filters, **more}

    def read(
        self, conn: Connection, statement: str, *, where: str = "true", texts: Mapping[str, str] | None = None, **more: Any
    ) -> list[Row]:  # fmt: skip
        """Rows of a statement as in `sql`; more: its own parameters. Raises DatabaseError."""
        with database_errors("The map cannot be read"):
            return execute(conn, self.sql(statement, where=where, texts=texts), self.values(**more))

    def page(
        self, conn: Connection, order: ListOrder, *, rows: int, offset: int = 0, after: tuple[str, int] | None = None,
        origin_m: list[float],
    ) -> list[Row]:  # fmt: skip
        """A page from a number of rows on, or after a row (text of its key, row_id), with these two columns besides those of
        the view."""
        key, row_id = after or (None, None)
        return self.read(
            conn, "page", where=order.after("last") if after else "true",
            texts={"key": order.key, "direction": "desc" if order.descending else "asc"},
            last_key=key, last_row=row_id, page_rows=rows, offset_rows=offset, origin_m=origin_m,
        )  # fmt: skip

    def count(self, conn: Connection, order: ListOrder, feature_id: UUID | None = None) -> tuple[int, int | None]:
        """Number of rows, and the index of one feature in an order; None: it is not among them."""
        found = self.read(conn, "sorted_by", texts={"key": order.key}, feature_id=feature_id) if feature_id else []
        at = found[0] if found else {"key": None, "row_id": None}
        before = f"not {order.after('own')} and s.version_row_id <> %(own_row)s" if found else "false"
        [row] = self.read(conn, "count", texts={"before": before}, own_key=at["key"], own_row=at["row_id"])
        return row["row_count"], row["before_count"] if found else None
