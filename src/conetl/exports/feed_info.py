"""Who publishes a work-zone feed, and what no image tells: a small `feed.yaml`, or flags of the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from conetl.files.yaml_model import read_yaml_mapping, validated
from conetl.model.errors import InputError

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
    name = "the feed's description" if path is None else f"feed {path}"
    values = {} if path is None else read_yaml_mapping(path, "feed", _EXAMPLE)
    values |= {key: value for key, value in flags.items() if value}
    missing = [key for key in ("publisher", "road_names") if not values.get(key)]
    if missing:
        raise InputError(
            f"{name}: WZDx wants {' and '.join(missing)}, which no image tells: name them with --publisher and --road-name, "
            f"or in a file for --feed:{_EXAMPLE}"
        )
    return validated(values, FeedInfo, name)
