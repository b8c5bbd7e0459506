"""The last arrow: tracks of one drive into the map, as one atomic changeset under the map's lock."""

from __future__ import annotations

from collections import Counter, defaultdict
from importlib.metadata import version
from typing import Any
from uuid import UUID, uuid5

import numpy as np
from prefect import task

from conetl.geometry.rig import map_SE3_left, map_SE3_right
from conetl.io import detector as detector_io
from conetl.io.cluster import database_url
from conetl.io.db import connect, migrate
from conetl.io.map_store import commit_changeset, find_changeset, map_transaction, read_current_features
from conetl.io.parquet_store import result_key
from conetl.params import IngestParams, params_sha256
from conetl.records import (
    Changeset,
    Delta,
    DeltaKind,
    Detection,
    Drive,
    MapFeature,
    Position,
    Record,
    StereoMatch,
    Track,
)
from conetl.rejections import INPUT_REASONS, Rejection
from conetl.reports import ChangeLine, IngestReport
from conetl.settings import Settings
from conetl.steps.changes import reconcile
from conetl.steps.visibility import Look, look_at_spot
from flows.tasks import _RETRY, lost_frame_pairs
