-- Reading and writing the neighbourhood of drives: which drives must be compared with the map again, and with what.
-- case when map_id ...: the planner would compare geometries first, and those of another map may have another CRS.

-- name: affected_drives
-- The drives that must be compared with the map again when some drives are added, removed or change status: the active
-- ones among them, every later one whose area meets one of theirs, and so on.
-- Parameters: drive_uuids (uuid[], of one map). Columns: drive_uuid, changeset_id, idempotency_key, in the order of the
-- fold.
-- offset 0: from each affected drive to its neighbours; otherwise the planner compares all drives of the map with each other.
with recursive affected (drive_uuid) as (
    select unnest(%(drive_uuids)s::uuid[])
    union
    select near.drive_uuid
    from affected a
    join conetl.drive d using (drive_uuid)
    cross join lateral (
        select l.drive_uuid, l.area from conetl.drive l
        where l.map_id = d.map_id and l.area && d.area
        and (l.captured_from_ns, l.content_sha256) > (d.captured_from_ns, d.content_sha256)
        offset 0
    ) near
    cross join lateral (select from conetl.active_drive v where v.drive_uuid = near.drive_uuid offset 0) active
    where ST_Intersects(near.area, d.area)
)
select d.drive_uuid, d.changeset_id, d.idempotency_key
from affected a
join conetl.active_drive d using (drive_uuid)
order by d.drive_order;

-- name: superseded_drives
-- The other analysis or delivery of the same recording that is active now, as newer_delivery knows it; this drive replaces it.
-- Parameters: drive_uuid. Columns: drive_uuid.
select other.drive_uuid
from conetl.drive d
join conetl.active_drive other on other.map_id = d.map_id and other.drive_uuid <> d.drive_uuid
where d.drive_uuid = %(drive_uuid)s
and (
    other.content_sha256 = d.content_sha256
    or (
        other.drive_id = d.drive_id and other.rig is not null and d.rig is not null
        and (other.captured_from_ns = d.captured_from_ns or other.captured_to_ns = d.captured_to_ns)
    )
);

-- name: drives_at
-- The active drives whose area comes within a radius of a position.
-- Parameters: map_name; easting_m, northing_m, radius_m (map CRS, which is in metres). Columns: drive_uuid.
select d.drive_uuid
from conetl.map m
join conetl.active_drive d on d.map_id = m.map_id
where m.map_name = %(map_name)s
and ST_DWithin(d.area, ST_SetSRID(ST_MakePoint(%(easting_m)s::float8, %(northing_m)s::float8), m.srid), %(radius_m)s);

-- name: standing_around
-- The open rows of the features that stand around a drive's path now, suppressed ones included: what the drive is compared with
-- where no later drive has been. Parameters: drive_uuid. Columns: as FeatureVersion, then version_row_id; of missed features
-- version_from_ns is later than their version: see rows_of_missed.
select distinct on (v.feature_id)
    {{feature columns of v}}, v.changeset_id, true as present, v.suppressed,
    v.valid_from_ns as version_from_ns, v.valid_from_ns, null::bigint as valid_to_ns, v.version_row_id
from conetl.drive d
cross join lateral conetl.pieces(d.area) piece
join conetl.feature_version v on v.map_id = d.map_id and v.geom && piece
    and case when v.map_id = d.map_id then ST_Intersects(v.geom, piece) else false end
where d.drive_uuid = %(drive_uuid)s
and upper_inf(v.system_period) and upper_inf(v.valid_period) and (v.present or v.suppressed)
order by v.feature_id;

-- name: rows_of_missed
-- All current rows of the standing versions of some features. Parameters: feature_ids (uuid[]).
-- Columns: as FeatureVersion, then version_row_id.
select
    {{feature columns of v}}, v.changeset_id, true as present, v.suppressed,
    min(v.valid_from_ns) over (partition by v.feature_id) as version_from_ns, v.valid_from_ns,
    lead(v.valid_from_ns) over (partition by v.feature_id order by lower(v.valid_period)) as valid_to_ns, v.version_row_id
from unnest(%(feature_ids)s::uuid[]) n (feature_id)
join conetl.feature_version o on o.cell = conetl.cell_of(n.feature_id) and o.feature_id = n.feature_id
    and upper_inf(o.system_period) and upper_inf(o.valid_period)
join conetl.feature_version v on v.cell = o.cell and v.feature_id = o.feature_id and v.version = o.version
    and upper_inf(v.system_period)
order by v.feature_id, lower(v.valid_period);

-- name: versions_around
-- All current rows of the features that ever stood around the paths of some drives.
-- Parameters: drive_uuids (uuid[], of one map).
-- Columns: as FeatureVersion, then version_row_id, drive_uuid, and the drive's fold key: captured_from_ns,
-- content_sha256, idempotency_key.
-- offset 0: one lookup per feature; the planner expects a single one around the paths, and would compare all versions with all.
with around as materialized (
    select distinct w.cell, w.feature_id
    from conetl.drive a
    cross join lateral conetl.pieces(a.area) piece
    join conetl.feature_version w on w.map_id = a.map_id and w.geom && piece
    and case when w.map_id = a.map_id then ST_Intersects(w.geom, piece) else false end
    where a.drive_uuid = any(%(drive_uuids)s) and upper_inf(w.system_period)
)
select
    {{feature columns of v}}, v.changeset_id, v.present or v.suppressed as present, v.suppressed,
    min(v.valid_from_ns) over (partition by v.feature_id, v.version) as version_from_ns, v.valid_from_ns,
    lead(v.valid_from_ns) over (partition by v.feature_id order by lower(v.valid_period)) as valid_to_ns,
    v.version_row_id, d.drive_uuid, d.captured_from_ns, d.content_sha256, c.idempotency_key
from around n
cross join lateral (
    select * from conetl.feature_version w
    where w.cell = n.cell and w.feature_id = n.feature_id and upper_inf(w.system_period)
    offset 0
) v
join conetl.changeset c on c.changeset_id = v.changeset_id
join conetl.drive d on d.drive_uuid = c.drive_uuid
order by v.feature_id, lower(v.valid_period);

-- name: misses_around
-- Every current miss (a drive to which the feature was visible did not observe it) of features that ever stood around
-- the paths of some drives, also those that a later drive made part of a removal.
-- Parameters: drive_uuids (uuid[], of one map).
-- Columns: as Miss, then drive_uuid and the drive's fold key: captured_from_ns, content_sha256, idempotency_key.
select
    x.feature_id, x.changeset_id, x.existence_after as existence_probability, x.changed_at_ns as missed_ns,
    d.drive_uuid, d.captured_from_ns, d.content_sha256, c.idempotency_key
from conetl.delta x
join conetl.changeset c on c.changeset_id = x.changeset_id
join conetl.drive d on d.drive_uuid = c.drive_uuid
where x.kind = 'missed' and upper_inf(x.system_period)
and (x.cell, x.feature_id) in (
    select w.cell, w.feature_id
    from conetl.drive a
    cross join lateral conetl.pieces(a.area) piece
    join conetl.feature_version w on w.map_id = a.map_id and w.geom && piece
    and case when w.map_id = a.map_id then ST_Intersects(w.geom, piece) else false end
    where a.drive_uuid = any(%(drive_uuids)s) and upper_inf(w.system_period)
)
order by x.feature_id, x.changeset_id;

-- name: current_deltas
-- The current deltas of some drives. Parameters: drive_uuids (uuid[]).
select
    x.delta_row_id, x.changeset_id, x.feature_id, x.kind, x.old_version, x.new_version, x.track_index, x.changed_at_ns, x.shift_m,
    x.other_feature_id, x.log_likelihood_ratio, x.existence_after, x.frames_seen, x.frames_empty
from conetl.changeset c
join conetl.delta x on x.changeset_id = c.changeset_id
where c.drive_uuid = any(%(drive_uuids)s) and upper_inf(x.system_period)
order by x.changeset_id, x.feature_id;

-- name: create_version_stage
-- Staging table for the new versions (units as in feature_version). valid_to counts only where is_open is false.
create temporary table version_stage on commit drop as
select
    feature_id, version, changeset_id, present, suppressed, {{state columns}},
    valid_from_ns, lower(valid_period) as valid_from, upper(valid_period) as valid_to, true as is_open
from conetl.feature_version
with no data;

-- name: create_replayed_delta_stage
-- Staging table for the new deltas of drives that were compared with the map again.
create temporary table replayed_delta_stage on commit drop as
select changeset_id, feature_id, old_version, new_version, {{change columns}}, of_line
from conetl.delta
with no data;

-- name: insert_staged_features
-- Add the features of staged versions that did not exist. Parameters: map_id; srid.
insert into conetl.feature (feature_id, map_id, srid, created_by, cell)
select s.feature_id, %(map_id)s, %(srid)s, s.changeset_id, conetl.cell_at(s.geom)
from version_stage s
where s.version = 1 and s.first_missed_ns is null
on conflict (feature_id) where map_id > 0 do nothing;

-- name: close_versions
-- End the system period of some versions. Parameters: committed_at (timestamptz); closed_versions (bigint[]).
update conetl.feature_version v
set system_period = tstzrange(lower(v.system_period), %(committed_at)s)
where v.version_row_id = any(%(closed_versions)s) and upper_inf(v.system_period);

-- name: close_deltas
-- End the system period of some deltas. Parameters: committed_at (timestamptz); closed_deltas (bigint[]).
update conetl.delta x
set system_period = tstzrange(lower(x.system_period), %(committed_at)s)
where x.delta_row_id = any(%(closed_deltas)s) and upper_inf(x.system_period);

-- name: insert_staged_versions
-- Write the staged versions with a system period from now on. Parameters: map_id; srid; committed_at (timestamptz).
insert into conetl.feature_version (
    cell, feature_id, version, map_id, srid, changeset_id, present, {{state columns}},
    valid_from_ns, valid_period, system_period, suppressed
)
select
    f.cell, s.feature_id, s.version, %(map_id)s, %(srid)s, s.changeset_id, s.present, {{state columns of s}}, s.valid_from_ns,
    tstzrange(s.valid_from, case when not s.is_open then s.valid_to end), tstzrange(%(committed_at)s, null),
    s.suppressed
from version_stage s
left join conetl.feature f on f.feature_id = s.feature_id and f.map_id > 0  -- a missing one is an error, not a row less
order by f.cell, s.feature_id, s.version;

-- name: insert_replayed_deltas
-- Write the staged deltas with a system period from now on. Parameters: committed_at (timestamptz).
insert into conetl.delta (
    cell, changeset_id, feature_id, old_version, new_version, {{change columns}}, of_line, system_period
)
select
    f.cell, s.changeset_id, s.feature_id, s.old_version, s.new_version, {{change columns of s}}, s.of_line,
    tstzrange(%(committed_at)s, null)
from replayed_delta_stage s
left join conetl.feature f on f.feature_id = s.feature_id and f.map_id > 0  -- a missing one is an error, not a row less
order by f.cell, s.feature_id, s.changed_at_ns;
