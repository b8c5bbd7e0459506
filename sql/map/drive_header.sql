-- Purpose: one ingested drive. Parameters: drive_uuid.
-- Columns: map_name, srid, drive_id, source_path, content_sha256, rig, captured_from_ns, expected_frame_count, reconcile, influence_m,
-- absence_figures; rig is null for an imported map.
select
    m.map_name, d.srid, d.drive_id, d.source_path, d.content_sha256, d.rig, d.captured_from_ns, d.expected_frame_count,
    d.reconcile, d.influence_m, d.absence_figures
from conetl.drive d
join conetl.map m using (map_id)
where d.drive_uuid = %(drive_uuid)s;
