-- Deleting raw records of old drives, or moving them to Parquet files and back.

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
-- Delete the stereo matches, detections and positions of some drives, and record that they have none.
-- Parameters: drive_uuids (uuid[]). Columns: deleted (number of rows).
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
    update conetl.drive d set pruned_at = now() where d.drive_uuid = any(%(drive_uuids)s) and d.pruned_at is null
)
select (select count(*) from stereo_matches) + (select count(*) from detections) + (select count(*) from positions) as deleted;

-- name: pruned_drives
-- Which of some drives no longer have raw records.
-- Parameters: drive_uuids (uuid[]). Columns: drive_uuid, drive_id, captured_to, pruned_at (timestamptz), archive_path (null: deleted);
-- rows (json: how many records each table had).
select
    d.drive_uuid, d.drive_id, upper(d.captured_period) as captured_to, d.pruned_at, d.archive_path,
    (
        select json_build_object(
            'detection', sum(c.detection_count), 'stereo_match', sum(c.match_count), 'position', sum(c.position_count)
        )
        from conetl.changeset c
        where c.drive_uuid = d.drive_uuid
    ) as rows
from conetl.drive d
where d.drive_uuid = any(%(drive_uuids)s) and d.pruned_at is not null
order by d.captured_from_ns;

-- name: archived_drives
-- Drives of a map whose raw records are in Parquet files. Parameters: map_name; drive_id (null: all). Columns: drive_uuid, drive_id.
select d.drive_uuid, d.drive_id
from conetl.drive d
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and d.archive_path is not null and (%(drive_id)s::text is null or d.drive_id = %(drive_id)s)
order by d.captured_from_ns, d.drive_uuid;

-- name: mark_archived
-- Record the path of the archived raw records of a drive that is being pruned. Parameters: drive_uuid; archive_path.
update conetl.drive set archive_path = %(archive_path)s where drive_uuid = %(drive_uuid)s;

-- name: mark_restored
-- Record that the raw records of a drive are in the tables again. Parameters: drive_uuid.
update conetl.drive set archive_path = null, pruned_at = null where drive_uuid = %(drive_uuid)s;

-- name: records_of_detection
-- The detections of a drive, as they are archived. Parameters: drive_uuid.
select d.drive_id, r.*
from conetl.detection r
join conetl.drive d using (drive_uuid)
where r.drive_uuid = %(drive_uuid)s
order by r.frame_index, r.side, r.detection_index;

-- name: records_of_stereo_match
-- The stereo matches of a drive, as they are archived. Parameters: drive_uuid.
select d.drive_id, r.*
from conetl.stereo_match r
join conetl.drive d using (drive_uuid)
where r.drive_uuid = %(drive_uuid)s
order by r.frame_index, r.match_index;

-- name: records_of_position
-- The positions of a drive, as they are archived: coordinates in metres of the map's CRS (EPSG: srid). Parameters: drive_uuid.
select
    d.drive_id, d.srid, r.drive_uuid, r.frame_index, r.match_index, r.category,
    ST_X(r.geom) as easting_m, ST_Y(r.geom) as northing_m, ST_Z(r.geom) as height_m,
    ST_X(r.centre_geom) as centre_easting_m, ST_Y(r.centre_geom) as centre_northing_m, ST_Z(r.centre_geom) as centre_height_m,
    r.cov_xx, r.cov_xy, r.cov_xz, r.cov_yy, r.cov_yz, r.cov_zz, r.object_height_m, r.camera_x_m, r.camera_y_m,
    r.camera_z_m, r.camera_cov_xx, r.camera_cov_xy, r.camera_cov_xz, r.camera_cov_yy, r.camera_cov_yz,
    r.camera_cov_zz, r.range_m, r.ray_angle_rad, r.residual_rms_px, r.iterations, r.score
from conetl.position r
join conetl.drive d using (drive_uuid)
where r.drive_uuid = %(drive_uuid)s
order by r.frame_index, r.match_index;
