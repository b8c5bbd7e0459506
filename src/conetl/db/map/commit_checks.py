"""Whether the records of a drive fit together, before they are written: tables of millions of rows have no foreign keys."""

from __future__ import annotations

from collections import Counter

from conetl.model.errors import MapMismatchError
from conetl.model.map_records import Changeset
from conetl.model.records import DriveRecords


def require_consistent(
    records: DriveRecords,
    changeset: Changeset,
) -> None:
    """Checks that foreign keys would make row by row, at a tenth of their cost. Raises MapMismatchError."""
    drive, detections, matches, positions, tracks, _ = records
    frames = {pair.frame_index for pair in drive.frame_pairs}
    boxes = {(d.frame_index, d.side, d.detection_index) for d in detections}
    positioned = {(p.frame_index, p.match_index) for p in positions}
    matched = {(m.frame_index, m.match_index) for m in matches}
    numbered = {track.track_index for track in tracks}
    problems = [
        *(f"detection of frame {f}, which the drive lacks" for f in {d.frame_index for d in detections} - frames),
        *(f"position of frame {f}, which the drive lacks" for f in {p.frame_index for p in positions} - frames),
        *(
            f"stereo match {m.match_index} of frame {m.frame_index} without its detections"
            for m in matches
            if not {(m.frame_index, b.side, b.detection_index) for b in (m.left, m.right)} <= boxes
        ),
        *(f"position {p} without its stereo match" for p in (positioned - matched if matches else ())),
        *(
            f"track {track.track_index} with the unknown position {member}"
            for track in tracks
            for member in track.members
            if member not in positioned
        ),
        *(
            f"delta of feature {d.feature_id} with the unknown track {d.track_index}"
            for d in changeset.deltas
            if d.track_index is not None and d.track_index not in numbered
        ),
        *(
            f"{count} deltas of feature {feature_id}, where one is allowed"
            for feature_id, count in Counter(d.feature_id for d in changeset.deltas).items()
            if count > 1
        ),
    ]
    if changeset.drive_id != drive.drive_id:
        problems.insert(0, f"a changeset of drive {changeset.drive_id}")
    if problems:
        more = f" and {len(problems) - 1} more problems" if len(problems) > 1 else ""
        raise MapMismatchError(f"drive {drive.drive_id} comes with {problems[0]}{more}: nothing was written.")
