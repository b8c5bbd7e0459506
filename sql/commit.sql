-- Writing a changeset: its row, its deltas merged into the map, the run that it came from, and its publication.

-- name: set_lock_timeout
-- How long this transaction waits for a lock. Parameters: timeout (for example '600s').
select set_config('lock_timeout', %(timeout)s, true);

-- name: lock_map
-- Let no other transaction change this map until this one ends. Parameters: map_name.
select pg_advisory_xact_lock(hashtextextended('conetl.map/' || %(map_name)s, 0));

-- name: share_map
-- Let only transactions change this map that share it, until this one ends. Parameters: map_name.
select pg_advisory_xact_lock_shared(hashtextextended('conetl.map/' || %(map_name)s, 0));

-- name: system_time
-- The system time of a new changeset: later than every earlier one of the map, even when the clock was set back.
-- Parameters: map_id.
select greatest(
    clock_timestamp(),
    (select max(c.committed_at) from conetl.changeset c where c.map_id = %(map_id)s) + interval '1 microsecond',
    (select max(d.decided_at) from conetl.decision d where d.map_id = %(map_id)s) + interval '1 microsecond'
) as committed_at;

-- name: insert_run
-- The run that made a changeset.
-- Parameters: as the columns.
insert into conetl.run (run_id, started_at, finished_at, params, flow_run_id, facts)
values (%(run_id)s, %(started_at)s, greatest(%(finished_at)s, %(started_at)s), %(params)s, %(flow_run_id)s, %(facts)s);

-- name: insert_run_step
-- How long one step of the run of a changeset took.
-- Parameters: changeset_id; step; task_count; busy_s (summed over its tasks); started_s, ended_s (since the run's first
-- step began).
insert into conetl.run_step (run_id, step, task_count, busy_s, started_s, ended_s)
select c.run_id, %(step)s, %(task_count)s, %(busy_s)s, %(started_s)s, %(ended_s)s
from conetl.changeset c
where c.changeset_id = %(changeset_id)s and c.run_id is not null
on conflict (run_id, step) do nothing;

-- name: changeset_exists
-- Whether a changeset id is in use, on any map. Parameters: changeset_id.
select exists (select from conetl.changeset c where c.changeset_id = %(changeset_id)s) as found;

-- name: insert_changeset
-- The changeset itself, with the counts that an audit compares with the rows. Under the map's lock.
-- Parameters: as the columns. Columns: changeset_no (counts per map).
insert into conetl.changeset (
    changeset_id, map_id, changeset_no, drive_uuid, run_id, idempotency_key, params_sha256, model_sha256, code_version, committed_at,
    added_count, confirmed_count, moved_count, removed_count, missed_count, height_changed_count, split_count, merged_count,
    line_counts, frame_pair_count, detection_count, match_count, position_count, track_count, marking_count, rejection_count
) values (
    %(changeset_id)s, %(map_id)s,
    (select coalesce(max(c.changeset_no), 0) + 1 from conetl.changeset c where c.map_id = %(map_id)s), %(drive_uuid)s, %(run_id)s, %(idempotency_key)s, %(params_sha256)s, %(model_sha256)s,
    %(code_version)s, %(committed_at)s,
    %(added_count)s, %(confirmed_count)s, %(moved_count)s, %(removed_count)s,
    %(missed_count)s, %(height_changed_count)s, %(split_count)s, %(merged_count)s,
    %(line_counts)s, %(frame_pair_count)s, %(detection_count)s, %(match_count)s, %(position_count)s, %(track_count)s, %(marking_count)s, %(rejection_count)s
)
returning changeset_no;

-- name: create_delta_stage
-- Where the deltas of one changeset are loaded, each with the resulting state of the feature (units as in
-- feature_version). is_change: false where a confirmation changes nothing. present: neither removed nor suppressed.
create temporary table delta_stage on commit drop as
select feature_id, old_version, true as is_change, {{change columns}}, present, suppressed, {{state columns}}
from conetl.delta
join conetl.feature_version using (cell, feature_id)
with no data;

-- name: create_open_version
-- The current open version of each staged feature that stands around the drive, found by position, where neighbours are
-- stored together. For the others see add_open_versions. present: suppressed ones too. Parameters: drive_uuid.
-- around is materialized: joined with the stage at once, the planner reads all of a map of ten million features.
create temporary table open_version on commit drop as
with around as materialized (
    select distinct on (v.feature_id)
        v.feature_id, v.cell, v.map_id, v.version_row_id, v.version, v.present or v.suppressed as present,
        lower(v.valid_period) as valid_from, v.valid_from_ns
    from conetl.drive d
    cross join lateral conetl.pieces(d.area) piece
    join conetl.feature_version v on v.map_id = d.map_id and v.geom && piece
    where d.drive_uuid = %(drive_uuid)s and upper_inf(v.system_period) and upper_inf(v.valid_period)
    and (v.present or v.suppressed)
    order by v.feature_id
)
select a.*
from around a
join delta_stage s using (feature_id);

-- name: add_open_versions
-- The open versions, in any map, of staged features that do not stand around the drive: the next statement looks for
-- conflicts among them. As a rule these are the new features, which have none. Their ids are spread over the index, as
-- the insertion of new features is anyway.
-- offset 0: one lookup in feature_version_current each, whatever the planner assumes about the tables' sizes; otherwise
-- it would read the whole table.
insert into open_version
select v.*
from delta_stage s
join lateral (select f.cell from conetl.feature f where f.feature_id = s.feature_id and f.map_id > 0 offset 0) f on true
cross join lateral (
    select
        w.feature_id, w.cell, w.map_id, w.version_row_id, w.version, w.present or w.suppressed,
        lower(w.valid_period), w.valid_from_ns
    from conetl.feature_version w
    where w.cell = f.cell and w.feature_id = s.feature_id
    and coalesce(upper(w.system_period), 'infinity') = 'infinity' and upper_inf(w.valid_period)
    offset 0
) v
where not exists (select from open_version o where o.feature_id = s.feature_id);

-- name: delta_conflicts
-- Staged deltas that do not fit the map because it was changed since it was read. No rows: all fit. Parameters: map_id.
-- Columns: old_version is the expected one; version, present: as found (true for suppressed features too, which take part
-- in the comparison of drives).
select s.feature_id, s.kind, s.old_version, o.version, o.present
from delta_stage s
left join open_version o using (feature_id)
where case
    when o.map_id <> %(map_id)s then true
    when s.kind in ('added', 'split') then coalesce(o.present, false)
    else not coalesce(o.present and o.version = s.old_version, false)
end
limit 10;

-- name: insert_features
-- Add the features that are new. Parameters: map_id; srid; changeset_id.
insert into conetl.feature (feature_id, map_id, srid, created_by, cell)
select s.feature_id, %(map_id)s, %(srid)s, %(changeset_id)s, conetl.cell_at(s.geom)
from delta_stage s
where s.kind in ('added', 'split')
on conflict (feature_id) where map_id > 0 do nothing;

-- name: end_versions
-- End the system period of the versions that this changeset replaces, and write each again as it is valid from now on:
-- only until its successor begins, which is at least a microsecond later, so that no state is ever lost.
-- any(array(...)): one lookup in the primary key each; a join would read the primary key from its start to the last of
-- them. Parameters: committed_at (timestamptz).
with closed as (
    update conetl.feature_version v
    set system_period = tstzrange(lower(v.system_period), %(committed_at)s)
    where v.version_row_id = any(
        array(select o.version_row_id from open_version o join delta_stage s using (feature_id) where s.is_change)
    )
    returning v.*
)
insert into conetl.feature_version (
    cell, feature_id, version, map_id, srid, changeset_id, present, {{state columns}},
    valid_from_ns, valid_period, system_period, suppressed
)
select
    v.cell, v.feature_id, v.version, v.map_id, v.srid, v.changeset_id, v.present, {{state columns of v}}, v.valid_from_ns,
    tstzrange(lower(v.valid_period), greatest(s.changed_at, lower(v.valid_period) + interval '1 microsecond')),
    tstzrange(%(committed_at)s, null), v.suppressed
from closed v
join delta_stage s using (feature_id)
order by v.cell, v.feature_id;

-- name: insert_versions
-- The new versions, open in both periods; each begins at least a microsecond after the one that it follows.
-- Parameters: map_id; srid; changeset_id; committed_at (timestamptz).
insert into conetl.feature_version (
    cell, feature_id, version, map_id, srid, changeset_id, present, {{state columns}},
    valid_from_ns, valid_period, system_period, suppressed
)
select
    coalesce(o.cell, (select f.cell from conetl.feature f where f.feature_id = s.feature_id and f.map_id > 0)),
    s.feature_id, coalesce(o.version, 0) + 1, %(map_id)s, %(srid)s, %(changeset_id)s, s.present, {{state columns of s}},
    greatest(s.changed_at_ns, o.valid_from_ns + 1000),
    tstzrange(greatest(s.changed_at, o.valid_from + interval '1 microsecond'), null), tstzrange(%(committed_at)s, null),
    s.suppressed
from delta_stage s
left join open_version o using (feature_id)
where s.is_change
order by 1, s.feature_id;

-- name: insert_deltas
-- Write the staged deltas, in the order of cells. Parameters: changeset_id; committed_at (timestamptz).
insert into conetl.delta (
    cell, changeset_id, feature_id, old_version, new_version, {{change columns}}, of_line, system_period
)
select
    coalesce(o.cell, (select f.cell from conetl.feature f where f.feature_id = s.feature_id and f.map_id > 0)),
    %(changeset_id)s, s.feature_id, s.old_version, case when s.is_change then coalesce(o.version, 0) + 1 else s.old_version end,
    {{change columns of s}}, s.line is not null, tstzrange(%(committed_at)s, null)
from delta_stage s
left join open_version o using (feature_id)
order by 1, s.feature_id;

-- name: has_outgrown
-- Whether new versions make the planner's statistics of a map's tables wrong.
-- Parameters: versions (written since). Columns: outgrown.
select 10 * %(versions)s >= c.reltuples as outgrown
from pg_class c
where c.oid = 'conetl.feature_version'::regclass;

-- name: is_published
-- Whether a changeset's events were handed to Prefect. Parameters: changeset_id. Columns: is_published.
select exists (select 1 from conetl.changeset_published t where t.changeset_id = %(changeset_id)s) as is_published;

-- name: mark_published
-- Remember that a changeset's events were handed to Prefect. Parameters: changeset_id.
insert into conetl.changeset_published (changeset_id) values (%(changeset_id)s) on conflict do nothing;

-- name: pending_changesets
-- Changesets of drives whose events were not handed to Prefect, oldest first. An import or a decision has no events.
-- Parameters: map_name; quiet_s: changesets younger than this are left to the runs that committed them. Columns: changeset_id.
select c.changeset_id
from conetl.changeset c
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid)
where m.map_name = %(map_name)s and d.kind = 'drive'
  and c.committed_at <= clock_timestamp() - make_interval(secs => %(quiet_s)s)
  and not exists (select from conetl.changeset_published t where t.changeset_id = c.changeset_id)
order by c.changeset_no;

-- name: removed_features
-- Point objects that a changeset removed, as committed. Parameters: changeset_id.
-- Columns: feature_id; easting_m, northing_m, height_m (map CRS), cone_height_m: the last known ones.
select x.feature_id, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m, v.cone_height_m
from conetl.delta x
join conetl.changeset c using (changeset_id)
join lateral (
    select o.geom, o.cone_height_m
    from conetl.feature_version o
    where o.cell = x.cell and o.feature_id = x.feature_id and o.version = x.old_version
    order by o.system_period @> c.committed_at desc, o.version_row_id desc
    limit 1
) v on true
where x.changeset_id = %(changeset_id)s and x.kind = 'removed' and not x.of_line and x.system_period @> c.committed_at
order by x.feature_id;
