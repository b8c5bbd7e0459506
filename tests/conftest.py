"""Fixtures that every test may use: a private PostGIS cluster, and small made-up drives and maps."""

from __future__ import annotations

import fcntl
import hashlib
import itertools
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import UUID, uuid5

import pytest
from hypothesis import settings

from conetl.model.map_records import Changeset, Delta, DeltaKind, MapFeature
from conetl.model.records import (
    Camera,
    Detection,
    Drive,
    DriveRecords,
    FramePair,
    Pose,
    Position,
    Rig,
    StereoMatch,
    Track,
)

# A busy machine is no defect of the code: tests do not assert times.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

HOMES = Path("/tmp")
TEMPLATE = "conetl_template"
_numbers = itertools.count()


def _test_home(config: pytest.Config) -> Path:
    """One cluster per test run, shared by the workers of pytest-xdist, whose parent is the run's main process."""
    main_pid = os.getppid() if hasattr(config, "workerinput") else os.getpid()
    return HOMES / f"conetl-test-{os.geteuid()}-{main_pid}"


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        _remove_leftovers()


def pytest_unconfigure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        _remove(_test_home(config))


def _remove(home: Path) -> None:
    from conetl.db.cluster.cluster import cluster_remove
    from conetl.services.processes import read_services, stop_service

    if home.is_dir():
        for service in read_services(home).values():
            stop_service(service)
        cluster_remove(home)
        shutil.rmtree(home)


def _remove_leftovers() -> None:
    """Services and clusters of test runs that were killed; their homes' names end with the run's process id."""
    for home in HOMES.glob(f"conetl-test-{os.geteuid()}-*"):
        if not Path(f"/proc/{home.name.rsplit('-', 1)[1]}").exists():
            _remove(home)


@pytest.fixture(scope="session")
def cluster_url(pytestconfig: pytest.Config) -> str:
    """A private cluster for this test run; fails with a clear message where PostGIS is not installed."""
    from conetl.db.cluster.cluster import cluster_up

    return cluster_up(_test_home(pytestconfig))


@pytest.fixture(scope="session")
def services_home(pytestconfig: pytest.Config) -> Path:
    """A home folder for services that outlive their command; the next test run ends what a killed one left there."""
    cluster_home = _test_home(pytestconfig)
    prefix, main_pid = cluster_home.name.rsplit("-", 1)
    return cluster_home.with_name(f"{prefix}-services-{main_pid}")


@pytest.fixture(scope="session")
def template_database(cluster_url: str, pytestconfig: pytest.Config) -> str:
    """A migrated database that each test clones."""
    from conetl.db.connection import connect, execute
    from conetl.db.schema import migrate

    with (_test_home(pytestconfig) / "template.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        conn = connect(cluster_url)
        conn.autocommit = True
        if not execute(conn, "select 1 from pg_database where datname = %(name)s", {"name": TEMPLATE}):
            execute(conn, "create database conetl_unfinished")
            unfinished = connect(cluster_url.replace("@/conetl?", "@/conetl_unfinished?"))
            migrate(unfinished)
            unfinished.close()
            execute(conn, f"alter database conetl_unfinished rename to {TEMPLATE}")
        conn.close()
    return TEMPLATE


@contextmanager
def cloned_database(cluster_url: str, template: str) -> Iterator[str]:
    """libpq URL of a new database, dropped at the end."""
    from conetl.db.connection import connect, execute

    name = f"t_{os.getpid()}_{next(_numbers)}"
    conn = connect(cluster_url)
    conn.autocommit = True
    execute(conn, f"create database {name} template {template}")
    yield cluster_url.replace("@/conetl?", f"@/{name}?")
    execute(conn, f"drop database {name} with (force)")
    conn.close()


@pytest.fixture(scope="session")
def another_database(cluster_url: str, template_database: str) -> Callable[[], AbstractContextManager[Any]]:
    """`with another_database() as conn`: an open connection to one more migrated, empty database."""
    from conetl.db.connection import connect

    @contextmanager
    def clone() -> Iterator[Any]:
        with cloned_database(cluster_url, template_database) as url, closing(connect(url)) as connection:
            yield connection

    return clone


@pytest.fixture
def database_url(cluster_url: str, template_database: str) -> Iterator[str]:
    """libpq URL of a migrated, empty database of this test's own."""
    with cloned_database(cluster_url, template_database) as url:
        yield url


@pytest.fixture(scope="module")
def module_database_url(cluster_url: str, template_database: str) -> Iterator[str]:
    """libpq URL of a migrated, empty database that the tests of one file share: they must leave it as they found it."""
    with cloned_database(cluster_url, template_database) as url:
        yield url


@pytest.fixture
def conn(database_url: str) -> Iterator[Any]:
    """Open connection to `database_url`."""
    from conetl.db.connection import connect

    connection = connect(database_url)
    yield connection
    connection.close()


# --------------------------------------------------------------------------- made-up records

SRID = 32632
DAY_NS = 86_400_000_000_000
#: 2026-03-01 08:00:00 UTC
START_NS = 1_772_352_000_000_000_000
_IDENTITY4 = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
_COV = (0.01, 0.001, 0.0, 0.02, 0.0, 0.04)
_NAMESPACE = UUID("00000000-0000-4000-8000-000000000000")


def sample_drive(
    drive_id: str = "drive_a",
    *,
    start_ns: int = START_NS,
    frames: int = 3,
    srid: int = SRID,
    content_sha256: str | None = None,
) -> Drive:
    camera = Camera(width_px=1242, height_px=375, fx_px=721.5, fy_px=721.5, cx_px=609.6, cy_px=172.9)
    right = ((1.0, 0.0, 0.0, 0.532), *_IDENTITY4[1:])
    pose = Pose(
        map_R_body=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        map_t_body_m=(458_000.5, 5_428_000.25, 115.125),
        sigma_enu_m=(0.3, 0.3, 0.5),
        sigma_rpy_rad=(0.001, 0.001, 0.002),
    )
    return Drive(
        drive_id=drive_id,
        source_path=f"drives/{drive_id}",
        rig=Rig(rig_id="rig", left=camera, right=camera, body_SE3_left=_IDENTITY4, body_SE3_right=right),
        map_srid=srid,
        content_sha256=content_sha256 or hashlib.sha256(drive_id.encode()).hexdigest(),
        frame_pairs=tuple(
            FramePair(
                frame_index=i,
                left_path=f"image_02/data/{i:010d}.png",
                right_path=f"image_03/data/{i:010d}.png",
                captured_at_ns=start_ns + i * 100_000_000 + 7,
                pose=pose,
            )
            for i in range(frames)
        ),
        expected_frame_count=frames,
    )


def sample_detections(frames: int = 3) -> list[Detection]:
    return [
        Detection(frame_index=i, side=side, detection_index=0, x_px=600.5, y_px=180, w_px=20, h_px=30, score=0.9)
        for i in range(frames)
        for side in ("left", "right")
    ]


def sample_matches(frames: int = 3) -> list[StereoMatch]:
    boxes = sample_detections(frames)
    return [
        StereoMatch(
            frame_index=i,
            match_index=0,
            left=boxes[2 * i],
            right=boxes[2 * i + 1],
            foot_left_uv_px=(610.0, 210.0),
            foot_right_uv_px=(580.0, 210.0),
            centre_left_uv_px=(610.0, 195.0),
            centre_right_uv_px=(580.0, 195.0),
            tip_left_uv_px=(610.0, 180.0),
            tip_right_uv_px=(580.0, 180.0),
            sigma_u_px=0.2,
            sigma_v_px=0.5,
            sigma_pointing_px=0.4,
            refined=True,
            cost=0.1,
        )
        for i in range(frames)
    ]


def sample_positions(frames: int = 3) -> list[Position]:
    return [
        Position(
            frame_index=i,
            match_index=0,
            xyz_m=(458_001.0, 5_428_010.0, 114.5),
            cov_m2=_COV,
            centre_xyz_m=(458_001.0, 5_428_010.0, 114.85),
            cone_height_m=0.7,
            camera_xyz_m=(0.5, 1.6, 12.0),
            camera_cov_m2=_COV,
            range_m=12.0,
            ray_angle_rad=0.04,
            residual_rms_px=0.3,
            iterations=3,
            score=0.9,
        )
        for i in range(frames)
    ]


def sample_track(track_index: int = 0, frames: int = 3) -> Track:
    return Track(
        track_index=track_index,
        xyz_m=(458_001.0, 5_428_010.0, 114.5),
        cov_m2=_COV,
        relative_cov_m2=_COV,
        centre_xyz_m=(458_001.0, 5_428_010.0, 114.85),
        cone_height_m=0.7,
        cone_height_sigma_m=0.02,
        existence_probability=0.97,
        observation_count=frames,
        first_seen_ns=START_NS + 7,
        last_seen_ns=START_NS + (frames - 1) * 100_000_000 + 7,
        residual_rms_px=0.3,
        nearest_range_m=9.0,
        members=tuple((i, 0) for i in range(frames)),
    )


def sample_feature(name: str = "cone", *, seen_ns: int = START_NS, **changes: Any) -> MapFeature:
    values: dict[str, Any] = {
        "feature_id": uuid5(_NAMESPACE, name),
        "version": 1,
        "category": "traffic_cone",
        "xyz_m": (458_001.0, 5_428_010.0, 114.5),
        "cov_m2": _COV,
        "centre_xyz_m": (458_001.0, 5_428_010.0, 114.85),
        "cone_height_m": 0.7,
        "cone_height_sigma_m": 0.02,
        "existence_probability": 0.97,
        "observation_count": 3,
        "first_seen_ns": seen_ns,
        "last_seen_ns": seen_ns + 200_000_000,
    }
    return MapFeature(**values | changes)


def added(feature: MapFeature, **changes: Any) -> Delta:
    values = {"changed_at_ns": feature.first_seen_ns, "track_index": 0, "shift_m": None} | changes
    return Delta(kind=DeltaKind.ADDED, feature_id=feature.feature_id, old=None, new=feature, **values)


def removed(feature: MapFeature, at_ns: int) -> Delta:
    return Delta(
        kind=DeltaKind.REMOVED,
        feature_id=feature.feature_id,
        old=feature,
        new=None,
        track_index=None,
        changed_at_ns=at_ns,
        shift_m=None,
    )


def changed(kind: str, old: MapFeature, at_ns: int, **changes: Any) -> Delta:
    new = old.model_copy(update={"version": old.version + 1, **changes})
    shift_m = ((new.xyz_m[0] - old.xyz_m[0]) ** 2 + (new.xyz_m[1] - old.xyz_m[1]) ** 2) ** 0.5
    return Delta(
        kind=DeltaKind(kind),
        feature_id=old.feature_id,
        old=old,
        new=new,
        track_index=0,
        changed_at_ns=at_ns,
        shift_m=shift_m,
    )


def sample_changeset(*deltas: Delta, drive_id: str = "drive_a", key: str = "1") -> Changeset:
    return Changeset(
        changeset_id=uuid5(_NAMESPACE, f"changeset {key}"),
        drive_id=drive_id,
        idempotency_key=key * (64 // len(key)),
        params_sha256="cd" * 32,
        model_sha256="ef" * 32,
        code_version="0.1.0",
        deltas=tuple(deltas),
    )


def commit_deltas(
    conn: Any, *deltas: Delta, key: str, start_ns: int = START_NS, map_name: str = "default", **options: Any
) -> Any:
    """Commit a small drive with these deltas; `key` is one or more hex digits, different for every drive."""
    from conetl.db.map.commit import commit_changeset
    from conetl.db.map.map_store import map_transaction

    # Recorded at the same instant; the content puts them into the order of their keys.
    drive = sample_drive(f"drive_{key}", start_ns=start_ns, content_sha256=f"{int(key, 16):064x}")
    with map_transaction(conn, map_name):
        return commit_changeset(
            conn,
            DriveRecords(drive, sample_detections(), sample_matches(), sample_positions(), [sample_track()]),
            sample_changeset(*deltas, drive_id=drive.drive_id, key=key),
            map_name=map_name,
            **options,
        )


@pytest.fixture(scope="session")
def samples() -> SimpleNamespace:
    """Makers of small valid records, and `commit(conn, *deltas, key=...)`."""
    return SimpleNamespace(
        SRID=SRID,
        DAY_NS=DAY_NS,
        START_NS=START_NS,
        drive=sample_drive,
        detections=sample_detections,
        matches=sample_matches,
        positions=sample_positions,
        track=sample_track,
        feature=sample_feature,
        added=added,
        removed=removed,
        changed=changed,
        changeset=sample_changeset,
        commit=commit_deltas,
    )
