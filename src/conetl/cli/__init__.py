"""The command line: `conetl --help` is the user's first page."""

from __future__ import annotations

import sys
import traceback

from conetl.cli.app import app
from conetl.cli.console import complain, err
from conetl.errors import EXIT_BUG, ConetlError

__all__ = ["main"]


def main() -> None:
    """Entry point of the `conetl` command: every error that conetl knows becomes one sentence and an exit code."""
    try:
        app(standalone_mode=True)
    except ConetlError as error:
        complain(error)
        sys.exit(error.exit_code)
    except Exception:
        traceback.print_exc()
        err.print("conetl: this is a mistake of conetl, not yours; please report it with the lines above.")
        sys.exit(EXIT_BUG)
