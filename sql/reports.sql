-- What reports of drives and nights read.

-- name: changeset
-- What a report of one changeset needs beyond the list of changesets. Parameters: changeset_id.
-- Columns: as below; rig is null for an imported map; params, facts and steps are empty where they were not kept.
select
    d.source_path, d.rig, d.pruned_at, coalesce(r.params, '{}') as params, coalesce(r.facts, '{}') as facts,
    coalesce((
        select jsonb_agg(to_jsonb(s) - 'run_id' order by s.started_s, s.step)
        from conetl.run_step s
        where s.run_id = c.run_id
    ), '[]') as steps
from conetl.changeset c
join conetl.drive d using (drive_uuid)
left join conetl.run r using (run_id)
where c.changeset_id = %(changeset_id)s;

-- name: rejections
-- Rejected records of a changeset by step and reason, the most frequent first, each with its first record as an
-- example. Parameters: changeset_id. Columns: step, reason, count, record, detail.
select step, reason, count(*) as count,
    (array_agg(record order by quarantine_id))[1] as record, (array_agg(detail order by quarantine_id))[1] as detail
from conetl.quarantine
where changeset_id = %(changeset_id)s
group by step, reason
order by count desc, step, reason;

-- name: residuals
-- Residuals of a drive's positions. Parameters: drive_uuid. Columns: frame_index, range_m, residual_rms_px.
select frame_index, range_m, residual_rms_px
from conetl.position
where drive_uuid = %(drive_uuid)s
order by frame_index, match_index;

-- name: sighting
-- The image pair that shows a cone best: the nearest position of a track. Parameters: drive_uuid; track_index.
-- Columns: as below; boxes in pixels of the rectified image.
-- nearest is materialized and looks up each position (offset 0): if the statistics are older than the drive, the planner
-- expects one row of it in each table, and would join the tables by the drive alone.
with nearest as materialized (
    select p.drive_uuid, p.frame_index, p.match_index, p.range_m
    from conetl.track_member t
    cross join lateral (
        select p.* from conetl.position p
        where p.drive_uuid = t.drive_uuid and p.frame_index = t.frame_index and p.match_index = t.match_index
        offset 0
    ) p
    where t.drive_uuid = %(drive_uuid)s and t.track_index = %(track_index)s
    order by p.range_m, p.frame_index
    limit 1
)
select
    n.frame_index, n.range_m, d.source_path, d.rig, f.left_path, f.right_path,
    coalesce(l.x_px, r.x_px + s.foot_left_u_px - s.foot_right_u_px) as left_x_px,
    coalesce(l.y_px, r.y_px + s.foot_left_v_px - s.foot_right_v_px) as left_y_px,
    coalesce(l.w_px, r.w_px) as left_w_px, coalesce(l.h_px, r.h_px) as left_h_px,
    coalesce(r.x_px, l.x_px + s.foot_right_u_px - s.foot_left_u_px) as right_x_px,
    coalesce(r.y_px, l.y_px + s.foot_right_v_px - s.foot_left_v_px) as right_y_px,
    coalesce(r.w_px, l.w_px) as right_w_px, coalesce(r.h_px, l.h_px) as right_h_px
from nearest n
join conetl.drive d using (drive_uuid)
join conetl.stereo_match s using (drive_uuid, frame_index, match_index)
join conetl.frame_pair f using (drive_uuid, frame_index)
left join conetl.detection l
    on l.drive_uuid = n.drive_uuid and l.frame_index = n.frame_index
    and l.side = 'left' and l.detection_index = s.left_detection_index
left join conetl.detection r
    on r.drive_uuid = n.drive_uuid and r.frame_index = n.frame_index
    and r.side = 'right' and r.detection_index = s.right_detection_index;

-- name: seen_before
-- The last drive that saw a feature among those recorded before another one.
-- Parameters: feature_id; before_ns (UTC ns). Columns: drive_uuid, track_index, drive_id, captured_from_ns.
select x.drive_uuid, x.track_index, x.drive_id, x.captured_from_ns
from conetl.feature_delta x
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s
and x.track_index is not null and upper_inf(x.system_period)
and x.drive_kind = 'drive' and x.captured_from_ns < %(before_ns)s
order by x.drive_order desc
limit 1;

-- name: map_size
-- Number of cones and other point objects on a map after each change, as the database knew it then. Parameters: map_name.
-- A present version that is open on the road is on the map during its system period.
with steps as (
    select e.at, sum(e.change) as change
    from conetl.feature_version v
    join conetl.map m using (map_id)
    cross join lateral (
        values (lower(v.system_period), 1), (upper(v.system_period), -1)
    ) e (at, change)
    where m.map_name = %(map_name)s and v.line is null and v.present and upper_inf(v.valid_period) and e.at is not null
    group by e.at
)
select at, sum(change) over (order by at)::bigint as standing
from steps
order by at;

-- name: night_drives
-- Changesets of a map that were committed in a time span, oldest first: figures for a report beside those of
-- history.changesets. Parameters: map_name; since; until.
-- Columns: changeset_id; residual_px and sigma_m (horizontal): medians of its cones, null without cones; notes: what its health
-- checks note, null without any; seconds: of its ingest, null without a receipt.
select
    c.changeset_id, t.residual_px, t.sigma_m,
    (
        select array_agg(k ->> 'detail')
        from conetl.run r
        cross join jsonb_array_elements(r.facts -> 'health') k
        where r.run_id = c.run_id and k ->> 'verdict' in ('note', 'warn') -- 'warn' until release 0.2
    ) as notes,
    (
        select r.seconds from conetl.receipt r
        where r.changeset_id = c.changeset_id and r.state in ('committed', 'held')
        order by r.receipt_no
        limit 1
    ) as seconds
from conetl.changeset c
join conetl.map m using (map_id)
cross join lateral (
    select
        percentile_cont(0.5) within group (order by k.residual_rms_px) as residual_px,
        percentile_cont(0.5) within group (
            order by {{sigma columns of k}}
        ) as sigma_m
    from conetl.track k
    where k.drive_uuid = c.drive_uuid
) t
where m.map_name = %(map_name)s and c.committed_at >= %(since)s and c.committed_at < %(until)s
order by c.changeset_no;

-- name: night_failures
-- Drives (by id and path: a repaired one has another header) whose last receipt before an instant is not a success, or that started
-- but did not end, oldest first. Parameters: map_name; until.
with last_receipt as (
    select distinct on (r.drive_id, r.drive_path) r.*
    from conetl.receipt r
    where r.map_name = %(map_name)s and r.at < %(until)s
    order by r.drive_id, r.drive_path, r.receipt_no desc
)
select
    w.drive_id, w.drive_path, w.state, w.reason, w.at, w.host, w.frame_pairs,
    (
        select count(distinct s.attempt_id) from conetl.receipt s
        where s.map_name = w.map_name and s.drive_id = w.drive_id and s.drive_path = w.drive_path and s.at < %(until)s
    ) as attempts
from last_receipt w
where w.state in ('failed', 'crashed', 'started')
order by w.receipt_no;

-- name: night_markings
-- Stretches of lane markings that drives committed in a time span changed, as known now, by kind of change.
-- Parameters: map_name; since; until. Columns: kind, count, length_m.
select x.kind, count(*) as count, sum(s.length_m) as length_m
from conetl.feature_delta x
join lateral conetl.state_after(x.cell, x.feature_id, x.new_version, x.changeset_id, 'infinity') s on true
where x.map_name = %(map_name)s and x.committed_at >= %(since)s and x.committed_at < %(until)s
and x.of_line and upper_inf(x.system_period)
group by x.kind
order by x.kind;

-- name: night_changes
-- Cones and other point objects that drives committed in a time span changed, as known now; those that are gone first, then moved
-- ones. Parameters: map_name; since; until; max_rows.
-- Columns: as below; total, gone: of all rows; xyz_m and sigma_m: of the state after the change; frames_empty: pairs without it.
with changed as (
    select
        x.*, count(*) over () as total, count(*) filter (where x.kind in ('removed', 'merged')) over () as gone,
        row_number() over (order by x.kind in ('removed', 'merged') desc, x.kind = 'moved' desc, x.changeset_no, x.feature_id) as number
    from conetl.feature_delta x
    where x.map_name = %(map_name)s and x.committed_at >= %(since)s and x.committed_at < %(until)s
    and x.kind not in ('confirmed', 'missed') and not x.of_line and upper_inf(x.system_period)
    order by number
    limit %(max_rows)s
)
select
    x.number, x.feature_id, x.kind, x.changeset_no, x.drive_id, x.changed_at, x.existence_after, x.frames_empty, x.shift_m, x.total,
    x.gone, s.category, array[s.easting_m, s.northing_m, s.ellipsoidal_height_m] as xyz_m, s.sigma_m
from changed x
join lateral conetl.state_after(x.cell, x.feature_id, x.new_version, x.changeset_id, 'infinity') s on true
order by x.number;

-- name: night_rejections
-- Rejected records of all drives committed in a time span, by step and reason.
-- Parameters: map_name; since; until. Columns: step, reason, count, drives.
select q.step, q.reason, count(*) as count, count(distinct c.changeset_id) as drives
from conetl.quarantine q
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and c.committed_at >= %(since)s and c.committed_at < %(until)s
group by q.step, q.reason
order by count desc, q.step, q.reason;

-- name: coverage
-- The squares of 256 m (map CRS), those of conetl.cell_at, that the active drives of a map passed, the one passed longest ago first.
-- Parameters: map_name; valid_until (timestamptz; 'infinity' = all): later frame pairs are left out.
-- Columns: west_m, south_m; drives, frame_pairs (numbers); last_at: when the last frame pair in it was captured.
select
    256 * floor(ST_X(f.geom) / 256) as west_m, 256 * floor(ST_Y(f.geom) / 256) as south_m,
    count(distinct d.drive_uuid) as drives, count(*) as frame_pairs,
    timestamptz 'epoch' + max(f.captured_at_ns) / 1000 * interval '1 microsecond' as last_at
from conetl.active_drive d
join conetl.map m using (map_id)
join conetl.frame_pair f using (drive_uuid)
where m.map_name = %(map_name)s
and timestamptz 'epoch' + f.captured_at_ns / 1000 * interval '1 microsecond' <= %(valid_until)s::timestamptz
group by west_m, south_m
order by last_at, south_m, west_m;
