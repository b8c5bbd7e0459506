"""Messages of one or two lines for wrong options, arguments and commands, with the most similar names."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError

from conetl.files.documents import expectation, shown


def usage_text(error: Any) -> str:
    """What is wrong with a command line, and the help page that says more. error: of typer, with `ctx` where it is known."""
    context = getattr(error, "ctx", None)
    text = _problem(error, context).rstrip(".")
    see = " See" if text.endswith("?") else "; see"
    return text if context is None else f"{text}{see} `{context.command_path} --help`"


def _problem(error: Any, context: Any) -> str:
    text = str(error.format_message())
    if isinstance(error.__cause__, ValidationError):
        first = error.__cause__.errors()[0]
        wanted = expectation(first)
        said = wanted if first["type"] == "value_error" else f"{shown(first['input'])}, {wanted}"
        return f"{text.partition(': ')[0].replace('Invalid value for', 'invalid value for', 1)}: {said}"
    if text.startswith("No such command"):
        name = text.split("'")[1]
        known = context.command.list_commands(context)
        near = _in_groups(name, context) or get_close_matches(name, known, n=2, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else f"commands are {', '.join(known)}"
        return f"there is no command {name!r}; {hint}"
    if text.startswith("No such option"):
        name = text.split(": ", 1)[1].split(" ", maxsplit=1)[0]
        known = [option for param in context.command.params for option in param.opts if option.startswith("--")]
        near = _as_settings(name) if "--set" in known else []
        near = near or get_close_matches(name, known, n=2, cutoff=0.5)
        return f"there is no option {name}" + (f"; did you mean {' or '.join(near)}?" if near else "")
    if text.startswith("Got unexpected extra argument"):
        extra = text.partition("(s) (")[2].rstrip(")")
        has_map = any("--map" in param.opts for param in context.command.params)
        return f"unexpected argument {extra}" + (f"; did you mean --map {extra}?" if has_map else "")
    return text[:1].lower() + text[1:]


def _as_settings(name: str) -> list[str]:
    """`--set images.start=...` for `--start`: keys of drive.yaml of this name."""
    from conetl.readers.drives.proposals.template import similar_keys  # the readers take time to load

    return [f"--set {key}=..." for key in similar_keys(name.lstrip("-"))]


def _in_groups(name: str, context: Any) -> list[str]:
    """`map export` for `export`: commands of this name in the groups of the command that was given."""
    groups = [group for group, target in getattr(context.command, "targets", {}).items() if not target]
    return [f"{group} {name}" for group in groups if name in context.command.get_command(context, group).targets]
