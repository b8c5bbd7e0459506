"""Named SQL statements: each `sql/<topic>.sql` holds those of one topic, headed by `-- name: <name>` and their purpose."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from conetl.model.errors import DatabaseError

_NAME = re.compile(r"^-- name: (\w+)\n", re.MULTILINE)


@cache
def sql_directory() -> Path:
    """The folder of .sql files: `conetl/sql` in an installed wheel, `sql/` at the top of a clone."""
    package = Path(__file__).resolve().parents[1]
    for directory in (package / "sql", package.parents[1] / "sql"):
        if (directory / "migrations").is_dir():
            return directory
    raise DatabaseError(f"conetl's .sql files are missing beside {package}: install it again.")


@cache
def statements(topic: str) -> dict[str, str]:
    """All statements of a topic by name, in the order of the file, with the comments that follow their names."""
    path = sql_directory() / f"{topic}.sql"
    try:
        _, *parts = _NAME.split(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DatabaseError(f"{path} cannot be read ({error.strerror}): install conetl again.") from error
    return {name: text.strip() for name, text in zip(parts[::2], parts[1::2], strict=True)}


def load_sql(name: str) -> str:
    """One statement by topic and name, for example load_sql("map.features_as_of")."""
    topic, _, statement = name.partition(".")
    try:
        return statements(topic)[statement]
    except KeyError:
        raise DatabaseError(
            f"{sql_directory() / topic}.sql has no statement {statement}: install conetl again."
        ) from None
