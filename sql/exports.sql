-- What exports and QGIS projects read.

-- name: snapshot
-- The open transaction reads a single state of the database. Must come before its first query.
set transaction isolation level repeatable read, read only;

-- name: memory
-- Memory for each sort and each join of the open transaction (a join may use twice as much) before it uses the disk.
-- Parameters: work_mem (for example '64MB').
set local work_mem = %(work_mem)s;

-- name: has_lines
-- Whether a map has or had lane markings. Parameters: map_id. Columns: found.
select exists (select from conetl.feature_version v where v.map_id = %(map_id)s and v.line is not null) as found;

-- name: has_class
-- Whether a map has or had objects of a class. Parameters: map_id, category. Columns: found.
select exists (
    select from conetl.feature_version v where v.map_id = %(map_id)s and v.category = %(category)s
) as found;

-- name: facts
-- What a manifest states about a map. Parameters: map_name.
-- Columns: licence (null where none was set), changeset_count, schema_version (the last migration).
select
    m.licence,
    (select count(*) from conetl.changeset c where c.map_id = m.map_id) as changeset_count,
    (select max(s.name) from conetl.schema_migration s) as schema_version
from conetl.map m
where m.map_name = %(map_name)s;

-- name: states
-- The map of an instant for other programs.
-- Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest); west_m, south_m, east_m, north_m (map CRS; all
-- null: everywhere), srid; lines: lane markings instead of point objects; category (null: all); spatial_order (Hilbert curve,
-- PostGIS's order of geometries), time_order (both false: by feature_id). {{columns}}: of conetl.feature_state.
select {{columns}}
from conetl.feature_states(
    %(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz,
    ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s)
) s
where (s.line is not null) = %(lines)s and (%(category)s::text is null or s.category = %(category)s)
order by case when %(spatial_order)s then s.geom end, case when %(time_order)s then s.valid_from end, s.feature_id;

-- name: history
-- Every state that the database ever held, or (known_at) that it held then.
-- Parameters: map_name, known_at, west_m, south_m, east_m, north_m, srid, lines, category, spatial_order, time_order: as states.
select {{columns}}
from conetl.feature_state s
where s.map_name = %(map_name)s and (%(known_at)s::timestamptz is null or s.system_period @> %(known_at)s::timestamptz)
and (s.line is not null) = %(lines)s and (%(category)s::text is null or s.category = %(category)s)
and conetl.is_in_box(
    s.geom, s.line, ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s)
)
order by
    case when %(spatial_order)s then s.geom end, case when %(time_order)s then s.valid_from end,
    s.feature_id, s.valid_from, s.system_from;

-- name: changes
-- Features that differ between two instants on the road, both as known at one instant. Parameters: from_valid_at, to_valid_at; and
-- map_name, known_at, lines, category, spatial_order, time_order: as states. {{columns}}: of conetl.feature_state, of the later state
-- (of removed features the one that says so), and of conetl.feature_changes.
select {{columns}}
from conetl.feature_changes(
    %(map_name)s, %(from_valid_at)s::timestamptz, %(to_valid_at)s::timestamptz, %(known_at)s::timestamptz
) c
join conetl.feature_state s using (version_row_id)
where (s.line is not null) = %(lines)s and (%(category)s::text is null or s.category = %(category)s)
order by case when %(spatial_order)s then s.geom end, case when %(time_order)s then s.valid_from end, s.feature_id;

-- name: qgis_extent
-- Extent in space and time of a map's current versions. Parameters: map_name.
-- Columns: west_m, south_m, east_m, north_m (map CRS), first_at, last_at (timestamptz); null for an empty map.
select
    min(s.easting_m) as west_m, min(s.northing_m) as south_m, max(s.easting_m) as east_m, max(s.northing_m) as north_m,
    min(s.valid_from) as first_at, max(greatest(s.valid_from, s.last_seen_at)) as last_at
from conetl.feature_state s
where s.map_name = %(map_name)s and s.system_to is null;

-- name: qgis_now
-- Layer of a QGIS project: the features that stand now. Parameters: map_name. {{columns}}, {{geometry}}: of conetl.feature_state.
select s.version_row_id, {{columns}}, s.{{geometry}} as geom
from conetl.feature_states(%(map_name)s) s
where (s.line is not null) = ('{{geometry}}' = 'line');

-- name: qgis_over_time
-- Layer of a QGIS project: the states of point objects as known now, for the temporal controller. Parameters: map_name.
select s.version_row_id, {{columns}}, s.{{geometry}} as geom
from conetl.feature_state s
where s.map_name = %(map_name)s and s.system_to is null and s.line is null and s.present;
