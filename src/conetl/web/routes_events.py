"""The stream that tells an open page of new changesets, decisions and base layers."""

from __future__ import annotations

from fastapi import APIRouter, HTTPException, Request
from fastapi.responses import StreamingResponse

from conetl.web.live import TOO_MANY, HeadWatcher
from conetl.web.parameters import MapName

router = APIRouter(tags=["events"])


@router.get("/maps/{map_name}/events", response_class=StreamingResponse)
async def events(map_name: MapName, request: Request) -> StreamingResponse:
    """Server-sent events, at once and after every commit: `changeset`, `decision` with number, `base`; `trouble` in words."""
    watcher: HeadWatcher = request.app.state.watcher
    if watcher.full():
        raise HTTPException(503, TOO_MANY, headers={"Retry-After": "30"})
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(watcher.events(map_name), media_type="text/event-stream", headers=headers)
