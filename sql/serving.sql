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
select ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as height_m
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

-- name: features
-- The features that stood on a map at one instant on the road, as the database knew it at another instant, with what a
-- list of them shows: map.features_as_of has the rest, and takes ten times as long.
-- Parameters: map_name; valid_at, known_at (timestamptz; 'infinity' = latest); max_rows.
-- Columns: sigma_m: along the major axis of the horizontal error ellipse; existence_probability: after the last drive to
-- which the feature was visible; changeset_no: of the changeset that wrote this version; marking: shape of a lane marking
-- (conetl.marking_json), whose position is that of the middle vertex; null of point objects.
with doubts as (
    select distinct on (x.feature_id, x.old_version) x.feature_id, x.old_version as version, x.existence_after
    from conetl.changeset c
    join conetl.map m using (map_id)
    join conetl.delta x using (changeset_id)
    join conetl.drive d using (drive_uuid)
    where m.map_name = %(map_name)s and x.kind = 'missed'
    and x.changed_at <= %(valid_at)s::timestamptz and x.system_period @> %(known_at)s::timestamptz
    order by
        x.feature_id, x.old_version,
        d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
)
select
    v.feature_id, v.version, v.category, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m,
    {{sigma columns of v}} as sigma_m,
    v.cone_height_m, coalesce(b.existence_after, v.existence_probability) as existence_probability,
    v.observation_count, v.last_seen_ns, c.changeset_no,
    {{marking columns of v}} as marking
from conetl.map_as_of(%(map_name)s, %(valid_at)s::timestamptz, %(known_at)s::timestamptz) v
join conetl.changeset c using (changeset_id)
left join doubts b using (feature_id, version)
order by v.feature_id
limit %(max_rows)s;

-- name: changes_between
-- Difference between the map at two instants, each as the database knew it at its own instant.
-- Parameters: map_name; from_valid_at, from_known_at, to_valid_at, to_known_at (timestamptz; 'infinity' = latest);
-- moved_from_m: horizontal distance (m) from which a feature counts as moved; line_moved_from_m: the same of lane markings,
-- across the line; max_rows.
-- Columns: as history.changes_of_changeset; changed_at is the beginning of the later state (null for removed); kind
-- 'confirmed' means the same position with other values, 'unchanged' the same version; changeset_no: of the changeset
-- that wrote the version which is shown.
with before as (
    select * from conetl.map_as_of(%(map_name)s, %(from_valid_at)s::timestamptz, %(from_known_at)s::timestamptz)
),
after as (
    select * from conetl.map_as_of(%(map_name)s, %(to_valid_at)s::timestamptz, %(to_known_at)s::timestamptz)
)
select
    coalesce(a.feature_id, b.feature_id) as feature_id,
    case
        when b.feature_id is null then 'added'
        when a.feature_id is null then 'removed'
        when ST_Distance(a.geom, b.geom) >= %(moved_from_m)s and b.line is null then 'moved'
        when ST_Distance(a.geom, b.line) >= %(line_moved_from_m)s then 'moved'
        when a.version <> b.version or not ST_Equals(a.geom, b.geom) then 'confirmed'
        else 'unchanged'
    end as kind,
    lower(a.valid_period) as changed_at, ST_Distance(a.geom, coalesce(b.line, b.geom)) as shift_m,
    ST_X(b.geom) as old_easting_m, ST_Y(b.geom) as old_northing_m, ST_Z(b.geom) as old_height_m,
    ST_X(coalesce(a.geom, b.geom)) as easting_m, ST_Y(coalesce(a.geom, b.geom)) as northing_m,
    ST_Z(coalesce(a.geom, b.geom)) as height_m,
    {{sigma columns of s}} as sigma_m,
    s.category, s.cone_height_m, s.existence_probability, s.observation_count, s.version, s.last_seen_ns, c.changeset_no,
    coalesce(
        {{marking columns of a}},
        {{marking columns of b}}
    ) as marking,
    {{marking columns of b}} as old_marking
from before b
full outer join after a using (feature_id)
cross join lateral (
    select
        coalesce(a.cov_xx, b.cov_xx) as cov_xx, coalesce(a.cov_xy, b.cov_xy) as cov_xy, coalesce(a.cov_yy, b.cov_yy) as cov_yy,
        coalesce(a.category, b.category) as category, coalesce(a.cone_height_m, b.cone_height_m) as cone_height_m,
        coalesce(a.existence_probability, b.existence_probability) as existence_probability,
        coalesce(a.observation_count, b.observation_count) as observation_count, coalesce(a.version, b.version) as version,
        coalesce(a.last_seen_ns, b.last_seen_ns) as last_seen_ns, coalesce(a.changeset_id, b.changeset_id) as changeset_id
) s
join conetl.changeset c on c.changeset_id = s.changeset_id
order by 1
limit %(max_rows)s;

-- name: feature_history
-- What every drive did to one feature of a map, in the order of the drives on the road.
-- Parameters: map_name; feature_id; known_at (timestamptz; 'infinity' = latest): as the database knew it then.
-- Columns: kind 'missed': visible but not observed, still standing; other_feature_id: of a split the common origin, of a
-- merger the feature that is left; frames_empty: frame pairs in which it was visible but not observed; position, covariance
-- (m^2) and values after the drive, of a removed feature the last ones, existence_probability with this drive's evidence;
-- sighting_count: frame pairs of this drive that it is based on; seen_count, missed_count: drives (not imported maps) that
-- saw and that missed the feature, up to and including this one.
select
    c.changeset_no, d.drive_id, d.drive_uuid, d.kind as drive_kind, d.captured_from_ns, x.kind, x.changed_at, c.committed_at,
    x.new_version as version, x.track_index, x.shift_m, x.other_feature_id, x.frames_seen, x.frames_empty, v.category,
    ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m,
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    {{sigma columns of v}} as sigma_m,
    v.cone_height_m, v.cone_height_sigma_m,
    coalesce(x.existence_after, v.existence_probability) as existence_probability,
    v.observation_count, v.first_seen_ns, v.last_seen_ns,
    {{marking columns of v}} as marking,
    (
        select count(*) from conetl.track_member t
        where t.drive_uuid = d.drive_uuid and t.track_index = x.track_index and v.line is null
    ) as sighting_count,
    count(*) filter (where x.kind not in ('missed', 'removed', 'merged') and d.kind = 'drive') over on_the_road as seen_count,
    count(*) filter (where x.kind in ('missed', 'removed')) over on_the_road as missed_count
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid)
join conetl.map m on m.map_id = c.map_id
join lateral (
    select * from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version
    order by v.system_period @> %(known_at)s::timestamptz desc, v.version_row_id desc  -- the one of then
    limit 1
) v on true
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and m.map_name = %(map_name)s
and x.system_period @> %(known_at)s::timestamptz
window on_the_road as (
    order by d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C"
    rows unbounded preceding
)
order by d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C";

-- name: sightings
-- The frame pairs in which a feature was seen, with the pose of the body. Parameters: map_name; feature_id; max_rows.
-- Columns: position and covariance (m, m^2) from this frame pair alone; body_* and map_r_body: pose of the body; left_*_px,
-- right_*_px: boxes in pixels of the rectified image.
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
    ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as height_m,
    p.cov_xx, p.cov_xy, p.cov_yy, p.range_m, p.residual_rms_px, p.score,
    ST_X(f.geom) as body_easting_m, ST_Y(f.geom) as body_northing_m, ST_Z(f.geom) as body_height_m, f.map_r_body,
    l.x_px as left_x_px, l.y_px as left_y_px, l.w_px as left_w_px, l.h_px as left_h_px, l.score as left_score,
    r.x_px as right_x_px, r.y_px as right_y_px, r.w_px as right_w_px, r.h_px as right_h_px, r.score as right_score
from seen t
join conetl.stereo_match s using (drive_uuid, frame_index, match_index)
join conetl.position p using (drive_uuid, frame_index, match_index)
join conetl.frame_pair f using (drive_uuid, frame_index)
join conetl.detection l
    on l.drive_uuid = t.drive_uuid and l.frame_index = t.frame_index
    and l.side = 'left' and l.detection_index = s.left_detection_index
join conetl.detection r
    on r.drive_uuid = t.drive_uuid and r.frame_index = t.frame_index
    and r.side = 'right' and r.detection_index = s.right_detection_index
order by t.changeset_no, f.captured_at_ns, t.frame_index;

-- name: trajectory
-- The poses of one drive's body, in order of time. Parameters: map_name; drive_uuid; max_rows.
select
    d.drive_id, d.rig, f.frame_index, f.captured_at_ns,
    ST_X(f.geom) as easting_m, ST_Y(f.geom) as northing_m, ST_Z(f.geom) as height_m, f.map_r_body
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
