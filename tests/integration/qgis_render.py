"""Run by the system's Python, which has QGIS: open a project, say what is in it as JSON, render it to a PNG.

python3 qgis_render.py PROJECT IMAGE
"""

import json
import os
import sys

from qgis.core import QgsApplication, QgsMapRendererSequentialJob, QgsMapSettings, QgsProject
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor

application = QgsApplication([], False)
application.initQgis()
project = QgsProject.instance()
read = project.read(sys.argv[1])
layers = [node.layer() for node in project.layerTreeRoot().findLayers()]
shown = [node.layer() for node in project.layerTreeRoot().findLayers() if node.isVisible()]
settings = QgsMapSettings()
settings.setLayers(shown)
settings.setDestinationCrs(project.crs())
settings.setOutputSize(QSize(1200, 700))
settings.setBackgroundColor(QColor("white"))
extent = shown[0].extent()
extent.grow(5)
settings.setExtent(extent)
job = QgsMapRendererSequentialJob(settings)
job.start()
job.waitForFinished()
job.renderedImage().save(sys.argv[2])
ranges = {layer.id(): layer.temporalProperties() for layer in layers}
print(
    json.dumps(
        {
            "read": read,
            "crs": project.crs().authid(),
            "errors": [str(error) for error in job.errors()],
            "time": [project.timeSettings().temporalRange().begin().toString("yyyy-MM-ddTHH:mm:ss")],
            "layers": {
                layer.id(): {
                    "valid": layer.isValid(),
                    "features": sum(1 for _ in layer.getFeatures()) if layer.isValid() else 0,
                    "renderer": layer.renderer().type(),
                    "temporal": ranges[layer.id()].isActive(),
                    "fields": [ranges[layer.id()].startField(), ranges[layer.id()].endField()],
                }
                for layer in layers
            },
        }
    )
)
sys.stdout.flush()
os._exit(0)  # QGIS's own end sometimes crashes, after all is done
