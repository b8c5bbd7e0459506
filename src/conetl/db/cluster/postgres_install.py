"""Find a PostgreSQL server on this machine whose PostGIS extension is installed.

Nothing is downloaded and nothing is started here; the system's packages provide both.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from conetl.model.errors import DatabaseError

#: Where distributions install the server's programs, beside PATH.
BIN_DIRECTORY_GLOBS = (
    "usr/lib/postgresql/*/bin",
    "usr/lib/postgresql*/bin",
    "usr/libexec/postgresql*",
    "usr/pgsql-*/bin",
    "usr/local/pgsql/bin",
    "usr/local/opt/postgresql*/bin",
    "opt/homebrew/opt/postgresql*/bin",
)
NEEDED_PROGRAMS = ("initdb", "pg_ctl", "postgres", "pg_isready", "pg_config")
NEEDED_EXTENSIONS = ("postgis", "btree_gist")
OWN_DATABASE_HINT = "or set CONETL_DATABASE_URL to a database that has PostGIS"


@dataclass(frozen=True)
class PostgresInstall:
    """One installed PostgreSQL server."""

    bin_directory: Path
    version: tuple[int, ...]
    """For example (15, 10)."""
    missing_extensions: tuple[str, ...]

    @property
    def major(self) -> int:
        return self.version[0]

    def program(self, name: str) -> str:
        return str(self.bin_directory / name)


def find_installs() -> list[PostgresInstall]:
    """All servers found, newest first, with or without PostGIS."""
    found = [probe_install(directory) for directory in _candidate_directories()]
    return sorted((install for install in found if install), key=lambda i: i.version, reverse=True)


def choose_install(installs: Iterable[PostgresInstall], *, data_major: int | None) -> PostgresInstall:
    """The newest server with PostGIS; for existing data, one of the major version that created them.

    Raises `DatabaseError` with one sentence about what to install.
    """
    installs = list(installs)
    usable = [i for i in installs if not i.missing_extensions]
    if data_major is not None:
        for install in usable:
            if install.major == data_major:
                return install
        raise DatabaseError(
            f"The map's data were created by PostgreSQL {data_major}, but PostgreSQL {data_major} with PostGIS is not "
            f"installed: run `sudo apt-get install postgresql-{data_major}-postgis-3`, restore a backup into a new cluster "
            f"(docs/operate/maintenance.md), {OWN_DATABASE_HINT}."
        )
    if usable:
        return usable[0]
    package = f"postgresql-{installs[0].major}-postgis-3" if installs else "postgresql-postgis"
    what = (
        f"PostgreSQL {installs[0].major} is installed, but PostGIS is not" if installs else "PostGIS is not installed"
    )
    raise DatabaseError(f"{what}: run `sudo apt-get install {package}`, {OWN_DATABASE_HINT}.")


def probe_install(directory: Path) -> PostgresInstall | None:
    """The server whose programs are in `directory`, or None if some of them are missing or do not run."""
    if not all((directory / name).is_file() for name in NEEDED_PROGRAMS):
        return None
    version = re.search(r"(\d+(?:\.\d+)*)", _output([str(directory / "postgres"), "--version"]))
    share = _output([str(directory / "pg_config"), "--sharedir"])
    if version is None or not share:
        return None
    extension_directory = Path(share) / "extension"
    missing = tuple(n for n in NEEDED_EXTENSIONS if not (extension_directory / f"{n}.control").is_file())
    return PostgresInstall(directory, tuple(int(part) for part in version[1].split(".")), missing)


def _candidate_directories() -> list[Path]:
    directories = [path for pattern in BIN_DIRECTORY_GLOBS for path in Path("/").glob(pattern)]
    for name in ("pg_ctl", "postgres"):
        program = shutil.which(name)
        if program:
            directories.append(Path(program).resolve().parent)
    return list(dict.fromkeys(path.resolve() for path in directories))


def _output(arguments: list[str]) -> str:
    try:
        done = subprocess.run(arguments, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
