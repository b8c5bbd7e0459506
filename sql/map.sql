-- Maps and their features: the map now, and at any instant on the road and in the database.

-- name: maps
-- All maps of this database. Columns: map_name, srid.
select map_name, srid from conetl.map order by map_name;

-- name: find_map
-- One map. Parameters: map_name.
-- Columns: map_id, map_name, id_name (in the ids of its features), srid, vertical_srid, last_committed_at (of changesets and
-- decisions; null while empty), counts (false while all its drives are on hold or reverted and nothing else is on it).
select
    m.map_id, m.map_name, coalesce(m.id_name, m.map_name) as id_name, m.srid, m.vertical_srid,
    greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)
    ) as last_committed_at,
    not exists (select from conetl.changeset c where c.map_id = m.map_id)
    or exists (select from conetl.active_drive a where a.map_id = m.map_id)
    or exists (select from conetl.feature f where f.map_id = m.map_id)
    or exists (select from conetl.base_source b where b.map_id = m.map_id) as counts
from conetl.map m
where m.map_name = %(map_name)s;

-- name: insert_map
-- Create a map unless it exists. Another map may have had its name, and features with that name in their ids.
-- Parameters: map_name; srid; vertical_srid (null: ellipsoidal heights).
insert into conetl.map (map_name, srid, vertical_srid, created_at, id_name)
select
    %(map_name)s, %(srid)s, %(vertical_srid)s, now(),
    (
        select format('%%s#%%s', m.id_name, (extract(epoch from now()) * 1000000)::bigint)
        from conetl.map m
        where m.id_name = %(map_name)s
    )
on conflict (map_name) do nothing;

-- name: set_aside
-- Give a map another name. Parameters: map_id; new_name.
update conetl.map set map_name = %(new_name)s where map_id = %(map_id)s;

-- name: set_licence
-- The licence of a map's data. Parameters: map_name; licence (null: none).
update conetl.map set licence = %(licence)s where map_name = %(map_name)s;

-- name: summary
-- One map in figures; versions are current ones, the extent is that of standing features (null where empty).
-- Parameters: map_name.
select
    m.map_name, m.srid,
    count(v.*) filter (where v.present and upper_inf(v.valid_period)) as feature_count,
    count(v.*) filter (where not v.present and not v.suppressed and upper_inf(v.valid_period)) as removed_count,
    count(v.*) filter (where v.first_missed_ns is null) as version_count,
    (select count(*) from conetl.changeset c where c.map_id = m.map_id) as changeset_count,
    greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)
    ) as last_committed_at,
    (select max(d.captured_to_ns) from conetl.drive d where d.map_id = m.map_id) as last_captured_to_ns,
    min(ST_X(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as west_m,
    min(ST_Y(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as south_m,
    max(ST_X(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as east_m,
    max(ST_Y(v.geom)) filter (where v.present and upper_inf(v.valid_period)) as north_m
from conetl.map m
left join conetl.feature_version v on v.map_id = m.map_id and upper_inf(v.system_period)
where m.map_name = %(map_name)s
group by m.map_id;

-- name: features_as_of
-- The features that stood on a map at one instant on the road, as known at another instant.
-- Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest); west_m, south_m, east_m, north_m (map
-- CRS; all null: everywhere); srid; max_rows (null: all); lines (true: lane markings, too).
-- Columns: as MapFeature (metres, m^2, UTC nanoseconds), then valid_from, valid_to (null while open), changeset_id.
select {{feature columns of v}}, s.valid_from, s.valid_to, s.changeset_id
from conetl.feature_states(
    %(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz,
    ST_MakeEnvelope(%(west_m)s::float8, %(south_m)s::float8, %(east_m)s::float8, %(north_m)s::float8, %(srid)s)
) s
join conetl.feature_version v using (version_row_id)
where s.line is null or %(lines)s
order by s.feature_id
limit %(max_rows)s;

-- name: changes
-- Features that differ between two instants, each as known at its own; a row per state, the earlier one first.
-- Parameters: map_name; from_at, known_from, to_at, known_at (timestamptz; 'infinity' = latest).
-- Columns: of conetl.feature_changes (change as kind), with changeset_no and drive_id of the row that is shown; is_old; as MapFeature.
select
    c.change as kind, c.changed_at, c.shift_m, n.changeset_no, n.drive_id, v.version_row_id = c.old_row_id as is_old,
    {{feature columns of v}}
from conetl.feature_changes(
    %(map_name)s, %(from_at)s::timestamptz, %(to_at)s::timestamptz, %(known_at)s::timestamptz, %(known_from)s::timestamptz
) c
join conetl.feature_state n using (version_row_id)
join conetl.feature_version v on v.version_row_id in (c.old_row_id, c.new_row_id)
order by c.feature_id, is_old desc;

-- name: find_features
-- Features of a map by the beginning of their id, standing or removed. Two rows are enough to show that it is
-- ambiguous. Parameters: map_name; beginning (lower case); first_id, last_id (uuid: no others begin so); max_rows.
-- Columns: feature_id. map_id > 0: for the index feature_by_id.
select f.feature_id
from conetl.feature f
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and f.feature_id between %(first_id)s and %(last_id)s and f.map_id > 0
and starts_with(f.feature_id::text, %(beginning)s)
order by f.feature_id
limit %(max_rows)s;

-- name: far_from_all
-- Which points are farther than far_m from every drive and imported map that counts; none if nothing counts.
-- Parameters: map_id; eastings_m, northings_m (float8[], map CRS); far_m. Columns: is_far, in the order of the points.
select exists (select from conetl.active_drive a where a.map_id = %(map_id)s) and not exists (
    select from conetl.active_drive d
    where d.map_id = %(map_id)s
    and ST_DWithin(d.area, ST_SetSRID(ST_MakePoint(p.easting_m, p.northing_m), d.srid), %(far_m)s)
) as is_far
from unnest(%(eastings_m)s::float8[], %(northings_m)s::float8[]) with ordinality as p (easting_m, northing_m, n)
order by p.n;

-- name: known_ids
-- Which of these ids are features of this database, and where each stands or last stood.
-- Parameters: feature_ids (uuid[]).
-- Columns: feature_id, map_name, easting_m, northing_m (of the open current version; null where there is none).
select f.feature_id, m.map_name, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m
from conetl.feature f
join conetl.map m using (map_id)
left join conetl.feature_version v
    on v.cell = f.cell and v.feature_id = f.feature_id and upper_inf(v.system_period) and upper_inf(v.valid_period)
where f.feature_id = any(%(feature_ids)s) and f.map_id > 0
order by f.feature_id;

-- name: versions_of_ids
-- All versions, also replaced ones, of the current features of a map with these ids. Parameters: map_id; feature_ids
-- (uuid[]). Columns: as MapFeature.
select {{feature columns of v}}
from conetl.feature f
join conetl.feature_version v on v.cell = f.cell and v.feature_id = f.feature_id
where f.feature_id = any(%(feature_ids)s) and f.map_id > 0 and f.map_id = %(map_id)s
and exists (
    select from conetl.feature_version now
    where now.cell = f.cell and now.feature_id = f.feature_id and upper_inf(now.system_period)
)
order by v.feature_id, v.version;

-- name: current_versions
-- Every current row of one feature or all features of a map that began no later than an instant, ended ones
-- included. Parameters: map_name; feature_id (null: all); valid_until (timestamptz; 'infinity' = all).
-- Columns: as FeatureVersion, valid_to_ns to the microsecond.
select
    {{feature columns of v}}, v.changeset_id, v.present or v.suppressed as present, v.suppressed,
    min(v.valid_from_ns) over (partition by v.feature_id, v.version) as version_from_ns, v.valid_from_ns,
    case
        when upper_inf(v.valid_period) then null
        else (extract(epoch from upper(v.valid_period)) * 1000000)::bigint * 1000
    end as valid_to_ns
from conetl.feature_version v
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and upper_inf(v.system_period) and lower(v.valid_period) <= %(valid_until)s::timestamptz
and (%(feature_id)s::uuid is null or (v.cell = conetl.cell_of(%(feature_id)s::uuid) and v.feature_id = %(feature_id)s))
order by v.feature_id, lower(v.valid_period);
