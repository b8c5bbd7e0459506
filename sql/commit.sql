-- Writing a changeset: its row, its deltas merged into the map, the run that it came from, and its publication.

-- name: set_lock_timeout
-- How long this transaction waits for a lock. Parameters: timeout (for example '600s').
select set_config('lock_timeout', %(timeout)s, true);

-- name: lock_map
-- Lock this map exclusively until the transaction ends. Parameters: map_name.
select pg_advisory_xact_lock(hashtextextended('conetl.map/' || %(map_name)s, 0));

-- name: share_map
-- Take this map's shared lock until the transaction ends. Parameters: map_name.
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
    change_counts, frame_pair_count, detection_count, match_count, position_count, track_count, marking_count, rejection_count
) values (
    %(changeset_id)s, %(map_id)s,
    (select coalesce(max(c.changeset_no), 0) + 1 from conetl.changeset c where c.map_id = %(map_id)s), %(drive_uuid)s, %(run_id)s, %(idempotency_key)s, %(params_sha256)s, %(model_sha256)s,
    %(code_version)s, %(committed_at)s,
    %(change_counts)s, %(frame_pair_count)s, %(detection_count)s, %(match_count)s, %(position_count)s, %(track_count)s, %(marking_count)s, %(rejection_count)s
)
returning changeset_no;

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
-- Record that a changeset's events were handed to Prefect. Parameters: changeset_id.
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
-- Columns: feature_id; xyz_m (map CRS), object_height_m: the last known ones.
select x.feature_id, array[s.easting_m, s.northing_m, s.ellipsoidal_height_m] as xyz_m, s.object_height_m
from conetl.feature_delta x
join lateral conetl.state_after(x.cell, x.feature_id, x.old_version, x.changeset_id, x.committed_at) s on true
where x.changeset_id = %(changeset_id)s and x.kind = 'removed' and not x.of_line and x.system_period @> x.committed_at
order by x.feature_id;
