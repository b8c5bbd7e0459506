-- What a person needs to judge changes: the drives that passed a position, their images, and pending decisions.

-- name: drives_past
-- The drives whose area contains a position, the latest first; those on hold and reverted ones too.
-- Parameters: map_name; easting_m, northing_m (map CRS); drive_uuids (uuid[], null: all); max_rows.
-- Columns: as below; rig, reconcile, absence_figures: JSON; counts: false where on hold, reverted or superseded.
select
    c.changeset_no, d.drive_id, d.drive_uuid, d.captured_from_ns, d.rig, d.reconcile, d.absence_figures,
    exists (select from conetl.active_drive a where a.changeset_id = c.changeset_id)
    and not exists (select from conetl.on_hold h where h.changeset_id = c.changeset_id) as counts
from conetl.map m
join conetl.drive d on d.map_id = m.map_id
join lateral (
    select k.changeset_no, k.changeset_id from conetl.changeset k
    where k.drive_uuid = d.drive_uuid
    order by k.changeset_no desc
    limit 1
) c on true
where m.map_name = %(map_name)s and d.kind = 'drive'
and ST_Intersects(d.area, ST_SetSRID(ST_MakePoint(%(easting_m)s::float8, %(northing_m)s::float8), m.srid))
and (%(drive_uuids)s::uuid[] is null or d.drive_uuid = any(%(drive_uuids)s::uuid[]))
order by d.captured_from_ns desc, c.changeset_no desc
limit %(max_rows)s;

-- name: observed_frames
-- The stereo matches of a feature. Parameters: map_name; feature_id. Columns: drive_uuid, kind (of the change by that drive),
-- frame_index, match_index (null where the drive did not observe it).
select c.drive_uuid, x.kind, t.frame_index, t.match_index
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
left join conetl.track_member t on t.drive_uuid = c.drive_uuid and t.track_index = x.track_index
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and m.map_name = %(map_name)s
and upper_inf(x.system_period);

-- name: tracks_near
-- Tracks of a drive in squares around places, without the one of a feature. Parameters: drive_uuid; eastings_m, northings_m
-- (float8[]); within_m; feature_id (null: with all). Columns: easting, northing, height (metres).
select ST_X(t.geom), ST_Y(t.geom), ST_Z(t.geom)
from conetl.track t
where t.drive_uuid = %(drive_uuid)s
and exists (
    select from unnest(%(eastings_m)s::float8[], %(northings_m)s::float8[]) n (x, y)
    where abs(ST_X(t.geom) - n.x) <= %(within_m)s and abs(ST_Y(t.geom) - n.y) <= %(within_m)s
)
and not exists (
    select from conetl.delta x
    join conetl.changeset c using (changeset_id)
    where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and upper_inf(x.system_period)
    and c.drive_uuid = t.drive_uuid and x.track_index = t.track_index
);

-- name: track_ranges
-- Nearest and farthest distance (m) at which tracks were observed, where their positions are kept.
-- Parameters: drive_uuids (uuid[]), track_indexes (integer[]), of the same length.
-- Columns: drive_uuid, track_index, near_m, far_m, frames (frame pairs).
-- offset 0: forces a lookup of each position; for a drive newer than its statistics the planner would choose worse.
select n.drive_uuid, n.track_index, min(p.range_m) as near_m, max(p.range_m) as far_m, count(distinct p.frame_index) as frames
from unnest(%(drive_uuids)s::uuid[], %(track_indexes)s::integer[]) n (drive_uuid, track_index)
join conetl.track_member t using (drive_uuid, track_index)
cross join lateral (
    select p.frame_index, p.range_m from conetl.position p
    where p.drive_uuid = t.drive_uuid and p.frame_index = t.frame_index and p.match_index = t.match_index
    offset 0
) p
group by n.drive_uuid, n.track_index;

-- name: frame
-- One frame pair with its rig. Parameters: map_name; drive_uuid; frame_index.
-- Columns: drive_id, rig (JSON), source_path, then as the frame pairs of drives.frame_pairs, with names.
select
    d.drive_id, d.rig, d.source_path, d.pruned_at, f.left_path, f.right_path, f.captured_at_ns,
    ST_X(f.geom) as easting_m, ST_Y(f.geom) as northing_m, ST_Z(f.geom) as ellipsoidal_height_m, f.map_r_body
from conetl.drive d
join conetl.map m using (map_id)
join conetl.frame_pair f using (drive_uuid)
where m.map_name = %(map_name)s and d.drive_uuid = %(drive_uuid)s and f.frame_index = %(frame_index)s;

-- name: frame_boxes
-- The detections of one frame pair, in pixels of the rectified images, and where the other image shows what the network found in
-- one only. Parameters: drive_uuid; frame_index.
-- Columns: side; box; score (null: not found in this image); match_index (null: without a stereo match), range_m of its position.
with boxes as (
    select
        b.side, b.x_px, b.y_px, b.w_px, b.h_px, b.score, b.detection_index, s.match_index
    from conetl.detection b
    left join conetl.stereo_match s
        on s.drive_uuid = b.drive_uuid and s.frame_index = b.frame_index
        and b.detection_index = case b.side when 'left' then s.left_detection_index else s.right_detection_index end
    where b.drive_uuid = %(drive_uuid)s and b.frame_index = %(frame_index)s
    union all
    select
        case b.side when 'left' then 'right' else 'left' end,
        b.x_px + case b.side when 'left' then 1 else -1 end * (s.foot_right_u_px - s.foot_left_u_px),
        b.y_px + case b.side when 'left' then 1 else -1 end * (s.foot_right_v_px - s.foot_left_v_px),
        b.w_px, b.h_px, null, null, s.match_index
    from conetl.stereo_match s
    join conetl.detection b
        on b.drive_uuid = s.drive_uuid and b.frame_index = s.frame_index
        and b.side = case when s.left_detection_index is null then 'right' else 'left' end
        and b.detection_index = coalesce(s.left_detection_index, s.right_detection_index)
    where s.drive_uuid = %(drive_uuid)s and s.frame_index = %(frame_index)s
    and num_nulls(s.left_detection_index, s.right_detection_index) = 1
)
select b.side, b.x_px, b.y_px, b.w_px, b.h_px, b.score, b.match_index, p.range_m
from boxes b
left join conetl.position p
    on p.drive_uuid = %(drive_uuid)s and p.frame_index = %(frame_index)s and p.match_index = b.match_index
order by b.side, b.detection_index, b.match_index;

-- name: review_changes
-- Cones without a decision that were removed (the latest first) or moved (the largest moves first) by the last drive that
-- changed them; an approval is of the change that it names alone. Parameters: map_name; first_row; max_rows; change ('removed'
-- or 'moved').
-- Columns: total (of all pages), feature_id (null on an empty page).
with found as (
    select v.feature_id, x.changed_at, case x.kind when 'moved' then x.shift_m end as shift_m
    from conetl.map m
    join conetl.feature_version v using (map_id)
    join conetl.delta x on x.cell = v.cell and x.feature_id = v.feature_id and x.new_version = v.version and upper_inf(x.system_period)
    cross join conetl.comparison(m.map_name, 'infinity') g
    where m.map_name = %(map_name)s and upper_inf(v.system_period) and upper_inf(v.valid_period)
    and v.line is null and v.present = (x.kind <> 'removed') and not v.suppressed and x.kind = %(change)s
    and (x.kind <> 'moved' or x.shift_m > g.moved_m)
    and not exists (
        select from conetl.active_decision a
        where a.map_id = m.map_id and (
            a.feature_id = v.feature_id and coalesce(a.approves, x.changeset_id) = x.changeset_id
            or ST_DWithin(a.geom, v.geom, a.radius_m)
        )
    )
)
select n.total, p.feature_id
from (select count(*) as total from found) n
left join lateral (
    select f.feature_id from found f
    order by f.shift_m desc nulls last, f.changed_at desc, f.feature_id
    limit %(max_rows)s offset %(first_row)s
) p on true;

-- name: review_doubtful
-- Standing cones without a decision whose existence probability is between two values; the least certain (nearest to 0.5) first.
-- Parameters: map_name; first_row; max_rows; least; most. Columns: as above.
with found as (
    select s.feature_id, s.existence_probability
    from conetl.feature_states(%(map_name)s) s
    where s.line is null and s.existence_probability between %(least)s and %(most)s
    and not exists (
        select from conetl.active_decision a
        where a.map_id = s.map_id and a.approves is null
        and (a.feature_id = s.feature_id or ST_DWithin(a.geom, s.geom, a.radius_m))
    )
)
select n.total, p.feature_id
from (select count(*) as total from found) n
left join lateral (
    select f.feature_id from found f
    order by abs(f.existence_probability - 0.5), f.feature_id
    limit %(max_rows)s offset %(first_row)s
) p on true;

-- name: last_changes
-- What the last drive that judged each of some features did to it. Parameters: map_name; feature_ids (uuid[]).
-- Columns: feature_id, changeset_id, then as serving.feature_history.
select n.feature_id, x.*
from unnest(%(feature_ids)s::uuid[]) n (feature_id)
cross join lateral (
    select
        x.changeset_id, x.changeset_no, x.drive_id, x.drive_uuid, x.drive_kind, x.captured_from_ns, x.kind, x.changed_at,
        x.new_version as version, x.track_index, x.shift_m, x.other_feature_id, x.frames_seen, x.frames_empty, s.category,
        s.easting_m, s.northing_m, s.ellipsoidal_height_m, s.object_height_m, s.sigma_m,
        coalesce(x.existence_after, s.existence_probability) as existence_probability
    from conetl.feature_delta x
    join lateral conetl.state_after(x.cell, x.feature_id, x.new_version, x.changeset_id, 'infinity') s on true
    where x.cell = conetl.cell_of(n.feature_id) and x.feature_id = n.feature_id and x.map_name = %(map_name)s
    and upper_inf(x.system_period)
    order by x.drive_order desc
    limit 1
) x;
