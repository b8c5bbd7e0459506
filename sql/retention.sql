-- Deleting raw records of old drives.

-- name: prunable_drives
-- The drives whose raw records may be deleted: recorded and committed before an instant, not pruned
-- yet, and not on hold; oldest first. Imported maps have none. Parameters: before (timestamptz).
-- Columns: map_name, drive_uuid, drive_id, captured_to (timestamptz), detection_count, match_count, position_count.
select
    m.map_name, d.drive_uuid, d.drive_id, upper(d.captured_period) as captured_to,
    sum(c.detection_count)::bigint as detection_count, sum(c.match_count)::bigint as match_count,
    sum(c.position_count)::bigint as position_count
from conetl.drive d
join conetl.map m using (map_id)
join conetl.changeset c using (drive_uuid)
where d.pruned_at is null and d.kind = 'drive'
and not exists (select from conetl.on_hold h where h.changeset_id = c.changeset_id)
group by m.map_name, d.drive_uuid
having upper(d.captured_period) < %(before)s and max(c.committed_at) < %(before)s
order by d.captured_from_ns, d.drive_uuid;

-- name: prune_drives
-- Delete the stereo matches, detections and positions of some drives, and remember that they have none any more.
-- Parameters: drive_uuids (uuid[]); pruned_at (timestamptz). Columns: deleted (number of rows).
with stereo_matches as (
    delete from conetl.stereo_match r where r.drive_uuid = any(%(drive_uuids)s) returning 1
),
detections as (
    delete from conetl.detection r where r.drive_uuid = any(%(drive_uuids)s) returning 1
),
positions as (
    delete from conetl.position r where r.drive_uuid = any(%(drive_uuids)s) returning 1
),
marked as (
    update conetl.drive d set pruned_at = %(pruned_at)s where d.drive_uuid = any(%(drive_uuids)s)
)
select (select count(*) from stereo_matches) + (select count(*) from detections) + (select count(*) from positions) as deleted;

-- name: pruned_drives
-- Which of some drives have no raw records any more.
-- Parameters: drive_uuids (uuid[]). Columns: drive_id, captured_to, pruned_at (timestamptz).
select d.drive_id, upper(d.captured_period) as captured_to, d.pruned_at
from conetl.drive d
where d.drive_uuid = any(%(drive_uuids)s) and d.pruned_at is not null
order by d.captured_from_ns;
