-- What the web view reads.

-- name: heads
-- The latest state of every map, cheap enough to be read several times a second.
-- Columns: map_name; changeset_no, decision_no (the newest ones of the map, 0 where there is none); base (a text that
-- differs where the imported base layers differ).
select
    m.map_name,
    coalesce((select max(c.changeset_no) from conetl.changeset c where c.map_id = m.map_id), 0) as changeset_no,
    coalesce((select max(d.decision_no) from conetl.decision d where d.map_id = m.map_id), 0) as decision_no,
    coalesce(
        (select md5(string_agg(s.source_id::text, ' ' order by s.source_id)) from conetl.base_source s where s.map_id = m.map_id),
        'none'
    ) as base
from conetl.map m;

-- name: origin
-- A point of the map's CRS near everything, from which the browser counts in metres (float32 cannot hold eastings). It
-- never changes while the map grows: the body of the first frame pair, or the first cone of a map that began with an
-- import. Parameters: map_name.
select ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as ellipsoidal_height_m
from conetl.changeset c
join conetl.map m using (map_id)
cross join lateral (
    (select f.geom from conetl.frame_pair f where f.drive_uuid = c.drive_uuid order by f.frame_index limit 1)
    union all
    (select s.geom from conetl.statement s where s.drive_uuid = c.drive_uuid order by s.statement_index limit 1)
) p
where m.map_name = %(map_name)s
order by c.changeset_no
limit 1;

-- name: is_now
-- Whether a state of a map is that of now, of which the numbers per cell are stored. Parameters: map_name; valid_at, known_at
-- (timestamptz; 'infinity' = latest). Columns: is_now.
select conetl.is_now(%(map_name)s, %(valid_at)s, %(known_at)s) as is_now;

-- name: stored_cells
-- The cells of a tile of the map now. Parameters: map_name; cell_zoom; west_m, south_m, east_m, north_m (of the tile; map CRS; cells
-- lie within it, or contain it). Columns: category; feature_count; sum_cm, x, y: as in conetl.feature_cell.
select c.x, c.y, c.category, c.feature_count, c.sum_cm
from conetl.feature_cell c
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and c.zoom = %(cell_zoom)s
and c.x >= %(west_m)s / 2 ^ (20 - %(cell_zoom)s) and c.x < %(east_m)s / 2 ^ (20 - %(cell_zoom)s)
and c.y >= %(south_m)s / 2 ^ (20 - %(cell_zoom)s) and c.y < %(north_m)s / 2 ^ (20 - %(cell_zoom)s);

-- name: counted_cells
-- The same of any state, or of smaller cells. Parameters: map_name; cell_zoom; west_m, south_m, east_m, north_m; srid (of the map);
-- valid_at, known_at (timestamptz; 'infinity' = latest). Columns: as stored_cells.
select
    floor(s.easting_m / 2 ^ (20 - %(cell_zoom)s))::bigint as x, floor(s.northing_m / 2 ^ (20 - %(cell_zoom)s))::bigint as y,
    s.category, count(*) as feature_count,
    array[
        sum(round(s.easting_m * 100)), sum(round(s.northing_m * 100)), sum(round(s.ellipsoidal_height_m * 100))
    ]::bigint[] as sum_cm
from conetl.feature_states(
    %(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz,
    ST_MakeEnvelope(%(west_m)s, %(south_m)s, %(east_m)s, %(north_m)s, %(srid)s)
) s
where s.easting_m >= %(west_m)s and s.easting_m < %(east_m)s and s.northing_m >= %(south_m)s and s.northing_m < %(north_m)s
group by 1, 2, 3;

-- name: features_in_tile
-- The features of a tile with what the view shows of them. Parameters: map_name; west_m, south_m, east_m, north_m (of the tile); srid
-- (of the map); valid_at, known_at (timestamptz; 'infinity' = latest); origin_m, from which positions count. Columns: of conetl.feature_state; marking: shape of a lane marking, null of point objects.
select {{listed columns of s}}, conetl.offset_m(s.geom, %(origin_m)s::float8[]) as xyz_m, {{marking columns of s}} as marking
from conetl.feature_states(
    %(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz,
    ST_MakeEnvelope(%(west_m)s, %(south_m)s, %(east_m)s, %(north_m)s, %(srid)s)
) s
where s.easting_m >= %(west_m)s and s.easting_m < %(east_m)s and s.northing_m >= %(south_m)s and s.northing_m < %(north_m)s
order by s.feature_id;

-- name: stored_summary
-- How many features of each class stand on a map now, and the cells around them. Parameters: map_name.
-- Columns: category; feature_count; west_m, south_m, east_m, north_m (map CRS, to 256 m).
select
    c.category, sum(c.feature_count) as feature_count, min(c.x) * 256::float8 as west_m, min(c.y) * 256::float8 as south_m,
    max(c.x + 1) * 256::float8 as east_m, max(c.y + 1) * 256::float8 as north_m
from conetl.feature_cell c
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and c.zoom = 12
group by c.category;

-- name: counted_summary
-- The same of any state. Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest). Columns: as stored_summary.
select
    s.category, count(*) as feature_count, min(s.easting_m) as west_m, min(s.northing_m) as south_m,
    max(s.easting_m) as east_m, max(s.northing_m) as north_m
from conetl.feature_states(%(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) s
group by s.category;

-- name: feature_history
-- What every drive did to one feature of a map, in the order of the drives on the road.
-- Parameters: map_name; feature_id; known_at (timestamptz; 'infinity' = latest): as known then; origin_m, from which xyz_m counts.
-- Columns: of conetl.feature_delta, and those of conetl.feature_state after it (of a removed feature the last position);
-- existence_probability, seen_count, missed_count: after this drive; sighting_count: frame pairs of this drive that it is based on.
select
    x.changeset_no, x.drive_id, x.drive_uuid, x.drive_kind, x.captured_from_ns, x.kind, x.changed_at, x.committed_at,
    x.new_version as version, x.track_index, x.shift_m, x.other_feature_id, x.frames_seen, x.frames_empty, s.category,
    s.easting_m, s.northing_m, s.ellipsoidal_height_m, conetl.offset_m(s.geom, %(origin_m)s::float8[]) as xyz_m,
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz, s.sigma_m,
    s.object_height_m, s.object_height_sigma_m, coalesce(x.existence_after, s.existence_probability) as existence_probability,
    s.observation_count, s.first_seen_at, s.last_seen_at, {{marking columns of s}} as marking,
    (
        select count(*) from conetl.track_member t
        where t.drive_uuid = x.drive_uuid and t.track_index = x.track_index and s.line is null
    ) as sighting_count,
    count(*) filter (where x.kind not in ('missed', 'removed', 'merged') and x.drive_kind = 'drive') over on_the_road as seen_count,
    count(*) filter (where x.kind in ('missed', 'removed')) over on_the_road as missed_count
from conetl.feature_delta x
join lateral conetl.state_after(x.cell, x.feature_id, x.new_version, x.changeset_id, %(known_at)s::timestamptz) s on true
join conetl.feature_version v using (version_row_id)
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and x.map_name = %(map_name)s
and x.system_period @> %(known_at)s::timestamptz
window on_the_road as (order by x.drive_order rows unbounded preceding)
order by x.drive_order;

-- name: sightings
-- The frame pairs in which a feature was seen, with the pose of the body. Parameters: map_name; feature_id; max_rows.
-- Columns: position and covariance (m, m^2) from this frame pair alone; body_* and map_r_body: pose of the body; left_*_px,
-- right_*_px: boxes in pixels of the rectified image; the score is null where the network found the object in the other image only.
-- In two steps, because planning one join of ten tables takes a hundred times as long as running it.
with seen as materialized (
    select c.changeset_no, d.drive_id, d.drive_uuid, t.frame_index, t.match_index
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    join conetl.map m using (map_id)
    join conetl.drive d using (drive_uuid)
    join conetl.track_member t on t.drive_uuid = d.drive_uuid and t.track_index = x.track_index
    where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and m.map_name = %(map_name)s
    and upper_inf(x.system_period)
    and not exists (  -- the track of a lane marking has no stereo matches
        select from conetl.feature_version v
        where v.cell = x.cell and v.feature_id = x.feature_id and v.line is not null
    )
    order by c.changeset_no, t.frame_index
    limit %(max_rows)s
)
select
    t.changeset_no, t.drive_id, t.drive_uuid, t.frame_index, t.match_index, f.captured_at_ns,
    ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as ellipsoidal_height_m,
    p.cov_xx, p.cov_xy, p.cov_yy, p.range_m, p.residual_rms_px, p.score,
    ST_X(f.geom) as body_easting_m, ST_Y(f.geom) as body_northing_m, ST_Z(f.geom) as body_ellipsoidal_height_m, f.map_r_body,
    coalesce(l.x_px, r.x_px + s.foot_left_u_px - s.foot_right_u_px) as left_x_px,
    coalesce(l.y_px, r.y_px + s.foot_left_v_px - s.foot_right_v_px) as left_y_px,
    coalesce(l.w_px, r.w_px) as left_w_px, coalesce(l.h_px, r.h_px) as left_h_px, l.score as left_score,
    coalesce(r.x_px, l.x_px + s.foot_right_u_px - s.foot_left_u_px) as right_x_px,
    coalesce(r.y_px, l.y_px + s.foot_right_v_px - s.foot_left_v_px) as right_y_px,
    coalesce(r.w_px, l.w_px) as right_w_px, coalesce(r.h_px, l.h_px) as right_h_px, r.score as right_score
from seen t
join conetl.stereo_match s using (drive_uuid, frame_index, match_index)
join conetl.position p using (drive_uuid, frame_index, match_index)
join conetl.frame_pair f using (drive_uuid, frame_index)
left join conetl.detection l
    on l.drive_uuid = t.drive_uuid and l.frame_index = t.frame_index
    and l.side = 'left' and l.detection_index = s.left_detection_index
left join conetl.detection r
    on r.drive_uuid = t.drive_uuid and r.frame_index = t.frame_index
    and r.side = 'right' and r.detection_index = s.right_detection_index
order by t.changeset_no, f.captured_at_ns, t.frame_index;

-- name: trajectory
-- The poses of one drive's body, in order of time. Parameters: map_name; drive_uuid; max_rows.
select
    d.drive_id, d.rig, f.frame_index, f.captured_at_ns,
    ST_X(f.geom) as easting_m, ST_Y(f.geom) as northing_m, ST_Z(f.geom) as ellipsoidal_height_m, f.map_r_body
from conetl.drive d
join conetl.map m using (map_id)
join conetl.frame_pair f using (drive_uuid)
where m.map_name = %(map_name)s and d.drive_uuid = %(drive_uuid)s
order by f.captured_at_ns
limit %(max_rows)s;

-- name: rigs
-- The rigs of some drives of a map. Parameters: map_name; drive_uuids (uuid[]). Columns: drive_uuid, rig (JSON).
select d.drive_uuid, d.rig
from conetl.drive d
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and d.drive_uuid = any(%(drive_uuids)s::uuid[]);
