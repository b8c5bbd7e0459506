"""Examples in the help of every command. A test checks that each one is a valid command line."""

from __future__ import annotations

EXAMPLES = {
    "ingest": ("ingest drives/2026-03-02", "ingest --map night_survey drives/*", "ingest drives/a --no-refine --json"),
    "backfill": ("backfill /srv/drives --since 2026-01-01 --dry-run", "backfill /srv/drives --max-parallel 4"),
    "watch": ("watch drives/today", "watch /mnt/nfs/today --poll --idle-seconds 60"),
    "init": (
        "init recording",
        "init recording --left l.mp4 --right r.mp4 --trajectory log.nmea --date 2026-03-02 --yes",
        "init recording --every 2 --from 10 --to 70",
    ),
    "inspect": ("inspect drives/2026-03-02", "inspect drives/2026-03-02 --page inspection.html"),
    "drive held": ("drive held", "drive held --map night_survey --json"),
    "drive accept": ('drive accept 12 --note "checked with the crew" --by Ann',),
    "map show": ("map show", "map show --as-of 2026-03-02 --map night_survey"),
    "map log": ("map log", "map log 1c223030"),
    "map diff": ("map diff 1 2", "map diff 2026-03-01 2026-03-08 --out week.geojson --image week.png"),
    "map picture": ('map picture map.png --at 2026-03-02 --title "L 605"', "map picture changes.pdf --changes 1 2"),
    "map export": (
        "map export --out cones.gpkg",
        "map export --out cones.parquet --as-of 2026-03-03",
        "map export --out changes.csv --what changes --from 2026-03-01 --to 2026-03-07",
        'map export --out feed.geojson --format wzdx --publisher "Road office" --road-name "L 605"',
    ),
    "map import": (
        "map import cones.gpkg",
        "map import cones.csv --crs EPSG:25832 --surveyed-at 2026-02-27 --sigma-m 0.3",
    ),
    "map list": ("map list",),
    "map create": ("map create night_survey --crs EPSG:25832", "map create city --crs EPSG:25832+7837"),
    "map rename": ("map rename default city_centre",),
    "map delete": ("map delete night_survey", "map delete night_survey --yes --dump night.zip"),
    "map restore": ("map restore night.zip", "map restore night.zip --map night_again"),
    "map licence": ("map licence", "map licence CC-BY-4.0"),
    "map qgis": ("map qgis --out cones.qgz", "map qgis --out cones.qgz --user anna"),
    "map check-layout": ("map check-layout --speed-kmh 50", "map check-layout --speed-kmh 80 --image layout.png"),
    "map check-points": ("map check-points survey.csv --crs EPSG:25832 --sigma-m 0.01",),
    "map suppress": ('map suppress 1c223030 --note "a bollard"', "map suppress 1c223030 --radius 2"),
    "map pin": ('map pin 1c223030 --note "surveyed by hand"',),
    "map classify": ('map classify 1c223030 drum --note "seen on site"',),
    "map revert": ("map revert 2", 'map revert 2 --note "wrong calibration" --by Ann'),
    "map decisions": ("map decisions",),
    "view": ("view", "view --map night_survey --port 8800", "view --decisions"),
    "report drive": ("report drive 2026-03-02_taper", "report drive 3 --out third.html"),
    "report night": ("report night", "report night 2026-03-03"),
    "base import": ("base import survey.laz lanes.osm", "base import lanes.geojson --layer lanes --crs 25832"),
    "base list": ("base list",),
    "base drop": ("base drop survey",),
    "up": ("up", "up --workers 4 --map night_survey"),
    "down": ("down",),
    "status": ("status", "status --json"),
    "db up": ("db up",),
    "db down": ("db down",),
    "db status": ("db status", "db status --json"),
    "db migrate": ("db migrate",),
    "db audit": ("db audit",),
    "db archive": (
        "db archive --keep-positions 90d",
        "db archive --keep-positions 90d --yes",
        "db archive --restore 2026-03-02_taper_pass1",
    ),
    "db prune": ("db prune --keep-positions 90d --keep-results 30d", "db prune --keep-results 30d --yes"),
    "demo": ("demo", "demo data/drives"),
    "detect": ("detect images --out detections.json --draw annotated",),
    "locate": ("locate left.png right.png --calibration rig.yaml",),
    "calibrate": (
        "calibrate boards --board chessboard:9x6:37.8mm --out rig.yaml --report report",
        "calibrate left.mp4 right.mp4 --board charuco:8x6:40mm:30mm --out rig.yaml",
    ),
    "rig show": ("rig show rig.yaml",),
    "rig convert": ("rig convert camchain.yaml rig.yaml --to rig",),
    "evaluate": ("evaluate drives/2026-03-02 --truth surveyed.csv --out accuracy",),
    "lidar-check": ("lidar-check drives/2026-03-02",),
    "simulate": ("simulate simulated --pass 1", "simulate mixed --world mixed --seed 3"),
}


def epilog_of(command: str) -> str | None:
    """The examples of a command in its help page."""
    lines = EXAMPLES.get(command)
    return None if lines is None else "\n\n".join(["Examples:", *(f"conetl {line}" for line in lines)])
