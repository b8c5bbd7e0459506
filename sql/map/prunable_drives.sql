-- Purpose: the drives whose raw records may go: recorded and committed before an instant, and not pruned yet; oldest first. Imported
-- maps have none.
-- Parameters: before (timestamptz). Columns: map_name, drive_uuid, drive_id, captured_to (timestamptz), detection_count, match_count,
-- position_count.
select
    m.map_name, d.drive_uuid, d.drive_id, upper(d.captured_period) as captured_to,
    sum(c.detection_count)::bigint as detection_count, sum(c.match_count)::bigint as match_count,
    sum(c.position_count)::bigint as position_count
from conetl.drive d
join conetl.map m using (map_id)
join conetl.changeset c using (drive_uuid)
where d.pruned_at is null and d.kind = 'drive'
group by m.map_name, d.drive_uuid
having upper(d.captured_period) < %(before)s and max(c.committed_at) < %(before)s
order by d.captured_from_ns, d.drive_uuid;
