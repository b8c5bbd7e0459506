"""Who publishes a work-zone feed, and what no picture tells: a small `feed.yaml`, or flags of the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from conetl.errors import InputError

CC0 = "https://creativecommons.org/publicdomain/zero/1.0/"
Direction = Literal[
    "northbound", "eastbound", "southbound", "westbound", "undefined", "unknown", "inner-loop", "outer-loop"
]
_EXAMPLE = """
publisher: City of Karlsruhe, road office
road_names: [L 605]
contact_email: roads@example.org   # optional, like all that follows
contact_name: Road office
license: cc0                       # WZDx knows this one only
update_frequency_s: 86400
organization_name: Survey Ltd      # whose data these are; default: the publisher
data_source_id: survey-2026        # default: made from publisher and map
direction: northbound              # default: from the heading of the drives"""


class FeedInfo(BaseModel):
    """What the feed says of itself and of the road."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    publisher: str = Field(min_length=1)
    road_names: tuple[str, ...] = Field(min_length=1)
    contact_name: str | None = None
    contact_email: str | None = Field(default=None, pattern=r"^[^@\s]+@[^@\s]+\.[^@\s]+$")
    license: Literal["cc0"] | None = None
    update_frequency_s: int | None = Field(default=None, ge=1)
    organization_name: str | None = Field(default=None, min_length=1)
    data_source_id: str | None = Field(default=None, min_length=1)
    direction: Direction | None = None


def read_feed_info(path: Path | None, **flags: Any) -> FeedInfo:
    """The file's values, flags that are not empty before them. Raises InputError naming what is missing or wrong."""
    values: dict[str, Any] = {}
    name = "the feed's description"
    if path is not None:
        name = f"feed {path}"
        try:
            read = yaml.safe_load(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise InputError(f"{name}: cannot be read ({error.strerror})") from error
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise InputError(f"{name}: not a YAML file ({error})") from error
        if not isinstance(read, dict):
            raise InputError(f"{name}: expected keys and values, for example:{_EXAMPLE}")
        values |= read
    values |= {key: value for key, value in flags.items() if value}
    missing = [key for key in ("publisher", "road_names") if not values.get(key)]
    if missing:
        raise InputError(
            f"{name}: WZDx wants {' and '.join(missing)}, which no picture tells: name them with --publisher and --road-name, "
            f"or in a file for --feed:{_EXAMPLE}"
        )
    try:
        return FeedInfo.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        hint = f"; one of {', '.join(get_args(Direction))}" if where == "direction" else ""
        raise InputError(f"{name}: {where}: {first['msg']}{hint}") from error
