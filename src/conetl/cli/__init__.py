"""The command line: `conetl --help` is the user's first page."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from types import FrameType

from conetl.cli.app import app
from conetl.cli.console import complain, err
from conetl.model.errors import EXIT_BUG, EXIT_INTERRUPTED, ConetlError

__all__ = ["main"]


class Interrupted(BaseException):
    """Ctrl-C. Not KeyboardInterrupt, which the command line's library turns into exit code 1, "done, but"."""


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """The first Ctrl-C lets the steps that run now end; a second one does not wait for them: nothing is lost by either."""
    signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))
    err.print("\nconetl: stopping; Ctrl-C again to stop at once")
    raise Interrupted


def main() -> None:
    """Entry point of the `conetl` command: every error that conetl knows becomes one sentence and an exit code."""
    signal.signal(signal.SIGINT, _interrupt)
    try:
        app(standalone_mode=True)
    except Interrupted:
        err.print(
            "conetl: interrupted; a drive is on the map as a whole or not at all. The same command again goes on from here."
        )
        sys.exit(EXIT_INTERRUPTED)
    except ConetlError as error:
        complain(error)
        sys.exit(error.exit_code)
    except Exception:
        traceback.print_exc()
        err.print("conetl: this is a mistake of conetl, not yours; please report it with the lines above.")
        sys.exit(EXIT_BUG)
