-- Maps as a whole: list, rename, delete, and the tables that a dump of one map consists of.

-- name: list_maps
-- All maps with their size. Columns: map_name, srid, vertical_srid, created_at, feature_count (standing now),
-- changeset_count, layer_count (base layers), last_committed_at (of changesets and decisions).
select
    m.map_name, m.srid, m.vertical_srid, m.created_at,
    (
        select coalesce(sum(c.feature_count), 0) from conetl.feature_cell c where c.map_id = m.map_id and c.zoom = 4
    ) as feature_count,
    (select count(*) from conetl.changeset c where c.map_id = m.map_id) as changeset_count,
    (select count(distinct b.layer_name) from conetl.base_source b where b.map_id = m.map_id) as layer_count,
    greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id)
    ) as last_committed_at
from conetl.map m
order by m.map_name;

-- name: rename_map
-- Rename a map, its receipts and watched drives; ids of features keep the first name of the map.
-- Parameters: map_id; map_name; new_name.
with renamed as (
    update conetl.map set map_name = %(new_name)s, id_name = coalesce(id_name, map_name) where map_id = %(map_id)s
),
receipts as (
    update conetl.receipt r set map_name = %(new_name)s
    where r.map_name = %(map_name)s and (
        r.changeset_id is null
        or exists (select from conetl.changeset c where c.changeset_id = r.changeset_id and c.map_id = %(map_id)s)
    )
)
update conetl.watched_drive set map_name = %(new_name)s where map_name = %(map_name)s;

-- name: map_row
-- What a dump keeps of conetl.map. Parameters: map_id. Columns: map_name, id_name, srid, vertical_srid, licence,
-- created_at.
select m.map_name, coalesce(m.id_name, m.map_name) as id_name, m.srid, m.vertical_srid, m.licence, m.created_at
from conetl.map m
where m.map_id = %(map_id)s;

-- name: tables
-- The tables of one map besides conetl.map, parents first. Not among them: provisional features, and who got which notice.
-- Columns: table_name; columns (without identity columns, which the database renumbers, and without map_id or
-- map_name); map_column (that one of both that it has, or null); condition (parameters map_id, map_name); sorting (by the
-- identity column, so that the new numbers rise as the old ones did, or null).
select
    t.table_name,
    string_agg(quote_ident(a.attname), ', ' order by a.attnum)
        filter (where a.attidentity = '' and a.attname not in ('map_id', 'map_name')) as columns,
    max(a.attname) filter (where a.attname in ('map_id', 'map_name')) as map_column,
    t.condition,
    max(quote_ident(a.attname)) filter (where a.attidentity <> '') as sorting
from (
    values
    (1, 'run', 'run_id in (select c.run_id from conetl.changeset c where c.map_id = %%(map_id)s)'),
    (2, 'run_step', 'run_id in (select c.run_id from conetl.changeset c where c.map_id = %%(map_id)s)'),
    (3, 'drive', 'map_id = %%(map_id)s'),
    (4, 'frame_pair', 'drive_uuid in (select d.drive_uuid from conetl.drive d where d.map_id = %%(map_id)s)'),
    (5, 'detection', 'drive_uuid in (select d.drive_uuid from conetl.drive d where d.map_id = %%(map_id)s)'),
    (6, 'stereo_match', 'drive_uuid in (select d.drive_uuid from conetl.drive d where d.map_id = %%(map_id)s)'),
    (7, 'position', 'drive_uuid in (select d.drive_uuid from conetl.drive d where d.map_id = %%(map_id)s)'),
    (8, 'track', 'drive_uuid in (select d.drive_uuid from conetl.drive d where d.map_id = %%(map_id)s)'),
    (10, 'marking_track', 'drive_uuid in (select d.drive_uuid from conetl.drive d where d.map_id = %%(map_id)s)'),
    (11, 'statement', 'drive_uuid in (select d.drive_uuid from conetl.drive d where d.map_id = %%(map_id)s)'),
    (12, 'changeset', 'map_id = %%(map_id)s'),
    (13, 'changeset_published', 'changeset_id in (select c.changeset_id from conetl.changeset c where c.map_id = %%(map_id)s)'),
    (14, 'quarantine', 'changeset_id in (select c.changeset_id from conetl.changeset c where c.map_id = %%(map_id)s)'),
    (15, 'hold', 'changeset_id in (select c.changeset_id from conetl.changeset c where c.map_id = %%(map_id)s)'),
    (16, 'feature', 'map_id = %%(map_id)s'),
    (17, 'feature_version', 'map_id = %%(map_id)s'),
    (18, 'delta', 'changeset_id in (select c.changeset_id from conetl.changeset c where c.map_id = %%(map_id)s)'),
    (19, 'decision', 'map_id = %%(map_id)s'),
    (20, 'base_source', 'map_id = %%(map_id)s'),
    (21, 'base_tile', 'source_id in (select b.source_id from conetl.base_source b where b.map_id = %%(map_id)s)'),
    (22, 'base_line', 'source_id in (select b.source_id from conetl.base_source b where b.map_id = %%(map_id)s)'),
    (
        23, 'receipt',
        '(changeset_id is null and map_name = %%(map_name)s)
        or changeset_id in (select c.changeset_id from conetl.changeset c where c.map_id = %%(map_id)s)'
    ),
    (24, 'plan', 'map_id = %%(map_id)s'),
    (25, 'plan_verdict', 'map_id = %%(map_id)s'),
    (26, 'notice', 'map_id = %%(map_id)s'),
    (27, 'zone_alias', 'map_id = %%(map_id)s')
) t (no, table_name, condition)
join pg_attribute a on a.attrelid = ('conetl.' || t.table_name)::regclass and a.attnum > 0 and not a.attisdropped
group by t.no, t.table_name, t.condition
order by t.no;

-- name: run_ids
-- The runs that made the changesets of a map. Parameters: map_id. Columns: run_id.
select c.run_id from conetl.changeset c where c.map_id = %(map_id)s and c.run_id is not null;

-- name: delete_map_row
-- Delete the rest of a map whose tables are empty. Parameters: map_id; map_name; run_ids. Columns: map_id.
with steps as (
    delete from conetl.run_step where run_id = any(%(run_ids)s::uuid[])
),
runs as (
    delete from conetl.run where run_id = any(%(run_ids)s::uuid[])
),
watched as (
    delete from conetl.watched_drive where map_name = %(map_name)s
)
delete from conetl.map where map_id = %(map_id)s returning map_id;

-- name: restore_map_row
-- The map itself, from its dump. Parameters: map_name; id_name (null where it is map_name); srid; vertical_srid; licence; created_at. Columns: map_id.
insert into conetl.map (map_name, id_name, srid, vertical_srid, licence, created_at)
values (%(map_name)s, %(id_name)s, %(srid)s, %(vertical_srid)s, %(licence)s, %(created_at)s)
returning map_id;

-- name: same_ids
-- The map whose features have this name in their ids, if any. Parameters: id_name. Columns: map_name.
select m.map_name from conetl.map m where coalesce(m.id_name, m.map_name) = %(id_name)s;
