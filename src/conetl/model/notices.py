"""What other systems are notified of: work zones of a map, and differences from plans."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any, Literal, NamedTuple
from uuid import NAMESPACE_URL, UUID, uuid5

_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/notice")


class Subject(NamedTuple):
    """A work zone, or a difference between a plan and the map; its notices are sent in their order."""

    topic: Literal["work_zone", "plan_difference"]
    subject_id: UUID


class Notice(NamedTuple):
    """What became of a subject."""

    notice_no: int
    subject: Subject
    event: Literal["began", "changed", "ended", "withdrawn"]
    recorded_at: datetime
    state: Mapping[str, Any]
    attempts: int = 0
    """To notify one receiver."""

    @property
    def kind(self) -> str:
        """As `work_zone.began`."""
        return f"{self.subject.topic}.{self.event}"

    def message_id(self, id_name: str) -> UUID:
        """The same for every attempt and receiver; id_name: of the map."""
        return uuid5(_NAMESPACE, f"{id_name}/{self.subject.subject_id}/{self.notice_no}/{self.recorded_at.isoformat()}")
