"""A small map with real images on disk, for the tests of the web view."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import uvicorn
from fastapi.testclient import TestClient
from pydantic import SecretStr

from conetl.db.map.map_store import map_transaction
from conetl.model.base import utc_from_ns
from conetl.model.drive import Detection, Drive, DriveRecords
from conetl.model.map_records import Delta, ExistenceEvidence, MapFeature
from conetl.web.app import create_app
from conetl.web.basemap import BaseMap
from conetl.web.decisions import Writer
from tests.records import not_seen

OWN = "http://127.0.0.1"


def with_images(drive: Drive, detections: Sequence[Detection], folder: Path) -> Drive:
    """The drive with grey images on disk, and an orange block in each detection."""
    camera = drive.rig.left
    for pair in drive.frame_pairs:
        for side, name in (("left", pair.left_path), ("right", pair.right_path)):
            image = np.full((camera.height_px, camera.width_px, 3), 128, np.uint8)
            for d in detections:
                if (d.frame_index, d.side) == (pair.frame_index, side):
                    x0, y0, x1, y1 = (round(v) for v in (d.x_px, d.y_px, d.x_px + d.w_px, d.y_px + d.h_px))
                    image[max(y0, 0) : y1, max(x0, 0) : x1] = (0, 128, 255)
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), image)
    return drive.model_copy(update={"source_path": str(folder)})


def commit(
    conn: Any, samples: SimpleNamespace, folder: Path, key: str, day: int, *deltas: Delta, map_name: str = "default"
) -> Any:
    """Commit a drive of day `day` (from 0) with images under `folder`; system time is noon of that day."""
    start_ns = samples.START_NS + day * samples.DAY_NS
    made = samples.drive(f"drive_{key}", start_ns=start_ns)
    drive = with_images(made, samples.detections(), folder / made.drive_id)
    noon = utc_from_ns(start_ns) + timedelta(hours=4)
    with map_transaction(conn, map_name), patch("conetl.db.map.commit.system_time", return_value=noon):
        return samples.write(
            conn,
            DriveRecords(drive, samples.detections(), samples.matches(), samples.positions(), [samples.track()]),
            samples.changeset(*deltas, drive_id=drive.drive_id, key=key),
            map_name=map_name,
        )  # fmt: skip


def cone(samples: SimpleNamespace, name: str, east_m: float, *, day: int = 0, **changes: Any) -> MapFeature:
    """A feature `east_m` east of the others, 10 m before the camera."""
    xyz_m = (458_001.0 + east_m, 5_428_010.0, 114.5)
    seen_ns = samples.START_NS + day * samples.DAY_NS + 7
    return samples.feature(name, seen_ns=seen_ns, xyz_m=xyz_m, centre_xyz_m=(*xyz_m[:2], 114.85), **changes)


def two_drives(conn: Any, samples: SimpleNamespace, folder: Path) -> dict[str, MapFeature]:
    """Day 0: `stays`, `goes`, `wanders`. Day 1: `stays` confirmed, `goes` removed, `wanders` 1.5 m east, `comes` new."""
    stays, goes, wanders = (cone(samples, name, 2.0 * i) for i, name in enumerate(("stays", "goes", "wanders")))
    commit(conn, samples, folder, "1", 0, *(samples.added(f) for f in (stays, goes, wanders)))
    at_ns = samples.START_NS + samples.DAY_NS + 7
    comes = cone(samples, "comes", 8.0, day=1, existence_probability=0.7)
    moved_m = (wanders.xyz_m[0] + 1.5, *wanders.xyz_m[1:])
    commit(
        conn, samples, folder, "2", 1,
        samples.changed("confirmed", stays, at_ns, observation_count=6),
        samples.removed(goes, at_ns),
        samples.changed("moved", wanders, at_ns, xyz_m=moved_m),
        samples.added(comes),
    )  # fmt: skip
    return {"stays": stays, "goes": goes, "wanders": wanders, "comes": comes}


def missed(feature: MapFeature, at_ns: int, existence: float, frames_empty: int = 5) -> Delta:
    """A drive that did not observe `feature` although it was visible, and kept it."""
    evidence = ExistenceEvidence(
        log_likelihood_ratio=-1.5, existence_probability=existence, frames_seen=0, frames_empty=frames_empty
    )
    return not_seen(feature, at_ns, existence).model_copy(update={"evidence": evidence})


def view_of(database_url: str, **options: Any) -> TestClient:
    """A client of the web view of the map `default`, to be entered by `with`."""
    return TestClient(create_app(database_url, "default", **options), base_url=OWN)


def shown(client: TestClient, map_name: str = "default", **asked: Any) -> dict[str, Any]:
    """The tile of 1,049 km that holds all of a small map, in one of its states."""
    path = f"/api/maps/{map_name}"
    found = client.get(f"{path}/summary", params=asked).json()
    west, south, *_ = found["box_m"] or (0.0, 0.0)
    x, y = (int((edge + origin) // 2**20) for edge, origin in zip((west, south), found["origin_m"], strict=False))
    answer: dict[str, Any] = client.get(f"{path}/tiles/0/{x}/{y}", params=asked).json()
    assert answer["count"] == len(answer["features"]) + len(answer["markings"]) == sum(found["categories"].values())
    return answer


@contextmanager
def serving(
    database_url: str,
    map_name: str,
    *,
    writer: Writer | None = None,
    reader_token: SecretStr | None = None,
    find_person: Any = lambda _: None,
    basemap: BaseMap | None = None,
    embed_host: str | None = None,
    port: int = 0,
) -> Iterator[int]:
    """The server as `conetl view` runs it, in a thread; yields its port (0: a free one)."""
    running: uvicorn.Server | None = None
    app = create_app(
        database_url,
        map_name,
        closing=lambda: running is not None and running.should_exit,
        writer=writer,
        reader_token=reader_token,
        find_person=find_person,
        base_map=basemap,
        embed_host=embed_host,
    )
    listener = socket.create_server(("127.0.0.1", port), backlog=2048)
    config = uvicorn.Config(app, log_level="critical", limit_concurrency=256, timeout_graceful_shutdown=1)
    running = uvicorn.Server(config)
    thread = threading.Thread(target=running.run, kwargs={"sockets": [listener]})
    thread.start()
    while not running.started:
        assert thread.is_alive(), "the server stopped"
        time.sleep(0.02)
    yield listener.getsockname()[1]
    running.should_exit = True
    thread.join()
