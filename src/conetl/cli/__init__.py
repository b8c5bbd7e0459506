"""The command line. It may import every package; `app.py` lists the commands, each module holds one command or group.

`main` is the entry point of the program `conetl`.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
from io import TextIOWrapper
from types import FrameType

import typer
from typer.exceptions import TyperException

from conetl.cli.app import app
from conetl.cli.console import complain, err
from conetl.model.errors import EXIT_BAD_INPUT, EXIT_BUG, EXIT_DONE, EXIT_INTERRUPTED, ConetlError

__all__ = ["app", "main"]


class Interrupted(BaseException):
    """Ctrl-C. Not KeyboardInterrupt, for which typer exits with code 1, "done, but something needs attention"."""


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """The first Ctrl-C waits for the steps that are running; the second one does not. Neither loses data."""
    signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))
    err.print("\nconetl: stopping after the current step; press Ctrl-C again to stop immediately")
    raise Interrupted


def main() -> None:
    """Run a command; every error becomes one message and an exit code."""
    signal.signal(signal.SIGINT, _interrupt)
    if isinstance(sys.stdout, TextIOWrapper):  # names of drives that the encoding of the terminal lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        code = app(standalone_mode=False)
    except Interrupted:
        err.print("conetl: interrupted. No drive is partly on the map; run the same command again to continue.")
        sys.exit(EXIT_INTERRUPTED)
    except ConetlError as error:
        complain(error)
        sys.exit(error.exit_code)
    except typer.Abort:  # at a question
        err.print("\nconetl: interrupted")
        sys.exit(EXIT_INTERRUPTED)
    except TyperException as error:
        from conetl.cli.usage import usage_text  # pydantic takes time to load

        if error.format_message():  # without one the help was printed
            complain(usage_text(error))
        sys.exit(EXIT_BAD_INPUT)
    except Exception as error:
        from conetl.services.processes import unavailable  # here: only now needed

        if lost := unavailable(error):
            complain(lost)
            sys.exit(lost.exit_code)
        traceback.print_exc()
        err.print("conetl: internal error. Please report it, with the traceback above.")
        sys.exit(EXIT_BUG)
    sys.exit(code if isinstance(code, int) else EXIT_DONE)
