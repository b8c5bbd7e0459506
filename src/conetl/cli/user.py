"""`conetl user add|list|remove`: who may log in to the map viewer, and what they may do there."""

from __future__ import annotations

from typing import Annotated

import typer

from conetl.cli import console as ui
from conetl.files.people import Role, add_person, read_people, remove_person
from conetl.pipeline.settings import read_settings

Name = Annotated[str, typer.Argument(help="Name of the person, as decisions state it.")]


def add(
    name: Name,
    role: Annotated[
        Role,
        typer.Option(
            help="read: see the map; review: also whole images, and decide about features; admin: also decide about drives."
        ),
    ] = "read",
    as_json: ui.JsonOption = False,
) -> None:
    """Create a login for the map viewer, and print its token, which is stored nowhere."""
    token = add_person(read_settings().home, name, role).get_secret_value()
    facts = {"name": name, "role": role, "token": token}
    ui.answer(
        as_json, facts, f"{name} ({role}) logs in to the map viewer with this token; it is not shown again:\n{token}"
    )


def users(as_json: ui.JsonOption = False) -> None:
    """List who may log in to the map viewer by name."""
    found = [{"name": one.name, "role": one.role} for one in read_people(read_settings().home)]
    if as_json:
        ui.print_json(found)
        return
    ui.print_records("", {"name": "name", "role": "role"}, found)
    if not found:
        ui.say("No users: everybody logs in with the view token.")


def remove(name: Name, as_json: ui.JsonOption = False) -> None:
    """Remove a login; its token is refused at once."""
    remove_person(read_settings().home, name)
    ui.answer(as_json, {"removed": name}, f"{name} cannot log in any more.")
