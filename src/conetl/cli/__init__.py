"""The command line: `conetl --help` is the user's first page."""

from __future__ import annotations

import sys

from conetl.cli.app import app
from conetl.cli.console import complain
from conetl.errors import ConetlError

__all__ = ["main"]


def main() -> None:
    """Entry point of the `conetl` command: every error that conetl knows becomes one sentence and an exit code."""
    try:
        app(standalone_mode=True)
    except ConetlError as error:
        complain(error)
        sys.exit(error.exit_code)
