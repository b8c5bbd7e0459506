"""conetl: stereo survey drives in, a versioned HD map of traffic cones out.

The names below are the Python API; they are imported when they are first used. Start with `conetl.pipeline`.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

# Steps run side by side on all cores. A linear algebra library would start as many threads for each of them, and how it shares
# sums among cores shows in their last bits: results would depend on the machine. It reads this when numpy or scipy is imported
# for the first time; a number of one's own stays.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# GDAL chooses the driver by the content of a file, whatever its name is. These read other files and addresses that the content
# names, or run programs. It reads this when pyogrio is imported for the first time.
os.environ.setdefault("OGR_SKIP", "OGR_VRT,GDALG,GPSBabel,ADBC,WFS,CSW,OAPIF,OGCAPI")
# MB of a feature of GeoJSON, of which GDAL needs several times as much memory; its own limit is 200.
os.environ.setdefault("OGR_GEOJSON_MAX_OBJ_SIZE", "10")

# Official builds of onnxruntime report models and machines to its maker from 1.29 on. It reads this when it is loaded.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

if TYPE_CHECKING:
    from conetl.geometry.packing import cov_matrix
    from conetl.model.drive import Detection, Drive, Position, StereoMatch, Track
    from conetl.model.errors import ConetlError, InputError, ServiceError
    from conetl.model.ingest_report import IngestReport
    from conetl.model.params import IngestParams
    from conetl.model.rig import Rig
    from conetl.perception.detector import detect_image, load_detector
    from conetl.pipeline.analysis import AnalysedDrive, analyse
    from conetl.pipeline.commit import CommittedDrive, commit
    from conetl.pipeline.ingest import ingest
    from conetl.pipeline.publish import publish
    from conetl.pipeline.settings import Settings
    from conetl.readers.drives import read_drive
    from conetl.tracking.matching.matches import match_pair
    from conetl.tracking.positions import locate_positions

_MODULES = {
    "conetl.geometry.packing": ("cov_matrix",),
    "conetl.model.drive": ("Detection", "Drive", "Position", "StereoMatch", "Track"),
    "conetl.model.errors": ("ConetlError", "InputError", "ServiceError"),
    "conetl.model.ingest_report": ("IngestReport",),
    "conetl.model.params": ("IngestParams",),
    "conetl.model.rig": ("Rig",),
    "conetl.perception.detector": ("detect_image", "load_detector"),
    "conetl.pipeline.analysis": ("AnalysedDrive", "analyse"),
    "conetl.pipeline.commit": ("CommittedDrive", "commit"),
    "conetl.pipeline.ingest": ("ingest",),
    "conetl.pipeline.publish": ("publish",),
    "conetl.pipeline.settings": ("Settings",),
    "conetl.readers.drives": ("read_drive",),
    "conetl.tracking.matching.matches": ("match_pair",),
    "conetl.tracking.positions": ("locate_positions",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "AnalysedDrive", "CommittedDrive", "ConetlError", "Detection", "Drive", "IngestParams", "IngestReport", "InputError",
    "Position", "Rig", "ServiceError", "Settings", "StereoMatch", "Track", "analyse", "commit", "cov_matrix", "detect_image",
    "ingest", "load_detector", "locate_positions", "match_pair", "publish", "read_drive",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'conetl' has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return __all__
