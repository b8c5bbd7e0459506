"""Run by the system's Python, which has QGIS: read a collection of the OGC API with QGIS's own provider, as JSON.

python3 qgis_ogc.py ADDRESS COLLECTION WEST,SOUTH,EAST,NORTH (or '' for all)
"""

from __future__ import annotations

import json
import sys

from qgis.core import QgsApplication, QgsFeatureRequest, QgsRectangle, QgsVectorLayer


def main() -> None:
    address, collection, box = sys.argv[1:]
    application = QgsApplication([], False)
    application.initQgis()
    place = f"url='{address}' typename='{collection}' restrictToRequestBBOX='{int(bool(box))}'"
    layer = QgsVectorLayer(place, "cones", "OAPIF")
    if not layer.isValid():
        raise SystemExit(f"QGIS cannot open it: {layer.dataProvider().error().message()}")
    request = QgsFeatureRequest()
    if box:
        request.setFilterRect(QgsRectangle(*map(float, box.split(","))))
    found = [
        {
            "id": feature["feature_id"],
            "lon": feature.geometry().constGet().x(),
            "lat": feature.geometry().constGet().y(),
            "height": feature.geometry().constGet().z(),
        }
        for feature in layer.getFeatures(request)
    ]
    names = [field.name() for field in layer.fields()]
    extent = layer.extent()
    print(json.dumps({
        "features": found, "fields": names, "crs": layer.crs().authid(), "title": layer.dataProvider().name(),
        "extent": [extent.xMinimum(), extent.yMinimum(), extent.xMaximum(), extent.yMaximum()],
    }))  # fmt: skip


if __name__ == "__main__":
    main()
