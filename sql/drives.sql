-- Ingested drives: header, path, tracks and raw records; imported maps, which have statements instead of tracks.

-- name: insert_drive
-- A drive, unless it exists.
-- Parameters: as the columns; captured_from, captured_to are the *_ns cut to microseconds; path_wkt: its path (line,
-- map CRS), which the area covers with a margin, because circles are drawn as polygons inside.
insert into conetl.drive (
    drive_uuid, map_id, srid, drive_id, source_path, content_sha256, rig,
    captured_from_ns, captured_to_ns, captured_period, expected_frame_count,
    reconcile, influence_m, absence_figures, area
)
select
    %(drive_uuid)s, %(map_id)s, %(srid)s, %(drive_id)s, %(source_path)s, %(content_sha256)s, %(rig)s,
    %(captured_from_ns)s, %(captured_to_ns)s,
    tstzrange(%(captured_from)s, %(captured_to)s, '[]'), %(expected_frame_count)s,
    %(reconcile)s, %(influence_m)s, %(absence_figures)s,
    ST_Buffer(ST_GeomFromText(%(path_wkt)s, %(srid)s), 1.05 * %(influence_m)s + 5)
where not exists (select from conetl.drive d where d.drive_uuid = %(drive_uuid)s)
on conflict (drive_uuid) do nothing;

-- name: belongs_elsewhere
-- Whether a drive is stored with another map: one that was set aside and had this map's name. Parameters: drive_uuid; map_id.
select exists (select from conetl.drive d where d.drive_uuid = %(drive_uuid)s and d.map_id <> %(map_id)s) as elsewhere;

-- name: insert_import
-- An imported map as a drive of kind import, unless it exists.
-- Parameters: drive_uuid, map_id, srid, drive_id (name of the file), source_path, content_sha256, reconcile (JSON),
-- influence_m: as the columns; stated_at_ns, stated_at: the instant that it describes (the latter cut to microseconds);
-- cells_wkt: points (map CRS) so that every cone is within cell_m of one.
insert into conetl.drive (
    drive_uuid, map_id, srid, kind, drive_id, source_path, content_sha256, rig,
    captured_from_ns, captured_to_ns, captured_period, expected_frame_count,
    reconcile, influence_m, area
) values (
    %(drive_uuid)s, %(map_id)s, %(srid)s, 'import', %(drive_id)s, %(source_path)s, %(content_sha256)s, null,
    %(stated_at_ns)s, %(stated_at_ns)s, tstzrange(%(stated_at)s, %(stated_at)s, '[]'), 0,
    %(reconcile)s, %(influence_m)s, ST_Buffer(ST_GeomFromText(%(cells_wkt)s, %(srid)s), 1.05 * (%(influence_m)s + %(cell_m)s) + 1)
)
on conflict (drive_uuid) do nothing;

-- name: statements
-- What an imported map states. Parameters: drive_uuid. Columns: as MapFeature of version 1, then valid_from_ns.
select
    s.feature_id, 1 as version, s.category, array[ST_X(s.geom), ST_Y(s.geom), ST_Z(s.geom)] as xyz_m,
    array[s.cov_xx, s.cov_xy, s.cov_xz, s.cov_yy, s.cov_yz, s.cov_zz] as cov_m2,
    array[ST_X(s.geom), ST_Y(s.geom), ST_Z(s.geom) + s.object_height_m / 2] as centre_xyz_m,
    s.object_height_m, s.object_height_sigma_m, s.existence_probability, s.observation_count, 0 as seen_count, 0 as missed_count,
    null as first_missed_ns, s.first_seen_ns, s.last_seen_ns,
    null as shared_jacobian, null as line, s.valid_from_ns
from conetl.statement s
where s.drive_uuid = %(drive_uuid)s
order by s.statement_index;

-- name: header
-- One ingested drive; rig is null for an imported map; id_name as map.find_map. Parameters: drive_uuid.
select
    d.drive_uuid, coalesce(m.id_name, m.map_name) as id_name, d.content_sha256, d.rig, d.captured_from_ns, d.reconcile,
    d.influence_m, d.absence_figures
from conetl.drive d
join conetl.map m using (map_id)
where d.drive_uuid = %(drive_uuid)s;

-- name: path
-- The path of a drive. Parameters: drive_uuid. Columns: easting, northing (metres of the map's CRS), by frame.
select ST_X(p.geom), ST_Y(p.geom)
from conetl.frame_pair p
where p.drive_uuid = %(drive_uuid)s
order by p.frame_index;

-- name: frame_pairs
-- The frame pairs of a drive. Parameters: drive_uuid; eastings_m, northings_m (float8[]), within_m: only those in squares around
-- places (map CRS; all null: everywhere). Columns: as FramePair and its Pose.
select {{frame_pair columns of p}}
from conetl.frame_pair p
where p.drive_uuid = %(drive_uuid)s and (
    %(within_m)s::float8 is null
    or exists (
        select from unnest(%(eastings_m)s::float8[], %(northings_m)s::float8[]) n (x, y)
        where abs(ST_X(p.geom) - n.x) <= %(within_m)s and abs(ST_Y(p.geom) - n.y) <= %(within_m)s
    )
)
order by p.frame_index;

-- name: detections
-- The detections of a drive. Parameters: drive_uuid; frames (integer[], null: all frame pairs).
-- Columns: as Detection (pixels of the original image).
select d.frame_index, d.side, d.detection_index, d.category, d.x_px, d.y_px, d.w_px, d.h_px, d.score
from conetl.detection d
where d.drive_uuid = %(drive_uuid)s and (%(frames)s::integer[] is null or d.frame_index = any(%(frames)s::integer[]))
order by d.frame_index, d.side, d.detection_index;

-- name: positions
-- The positions of a drive, frame by frame.
-- Parameters: drive_uuid; frames (integer[], null: all). Columns: frame_index, category, easting, northing, height (metres).
select p.frame_index, p.category, ST_X(p.geom), ST_Y(p.geom), ST_Z(p.geom)
from conetl.position p
where p.drive_uuid = %(drive_uuid)s and (%(frames)s::integer[] is null or p.frame_index = any(%(frames)s::integer[]))
order by p.frame_index, p.match_index;

-- name: tracks
-- The tracks of a drive. Parameters: drive_uuid.
-- Columns: as Track (metres, m^2, ns); members as (frame, match) pairs in a two-dimensional array; shared_jacobian:
-- calibrations and shared_jacobian_m as PostgreSQL sends them, concatenated.
select
    t.track_index, t.category, array[ST_X(t.geom), ST_Y(t.geom), ST_Z(t.geom)] as xyz_m,
    array[t.cov_xx, t.cov_xy, t.cov_xz, t.cov_yy, t.cov_yz, t.cov_zz] as cov_m2,
    array[
        t.relative_cov_xx, t.relative_cov_xy, t.relative_cov_xz, t.relative_cov_yy, t.relative_cov_yz, t.relative_cov_zz
    ] as relative_cov_m2,
    array[ST_X(t.centre_geom), ST_Y(t.centre_geom), ST_Z(t.centre_geom)] as centre_xyz_m,
    t.object_height_m, t.object_height_sigma_m, t.existence_probability, t.observation_count, t.first_seen_ns, t.last_seen_ns,
    t.residual_rms_px, t.nearest_range_m, t.members,
    array_send(t.calibrations) || array_send(t.shared_jacobian_m) as shared_jacobian
from conetl.track t
where t.drive_uuid = %(drive_uuid)s
order by t.track_index;

-- name: marking_tracks
-- The lane markings of a drive. Parameters: drive_uuid.
-- Columns: as MarkingTrack (metres, m^2, ns), the last nine as in map.features_as_of.
select
    t.marking_index, t.category, t.relative_cov, t.existence_probability, t.observation_count, t.first_seen_ns, t.last_seen_ns,
    t.contrast, t.blur_px, array_send(t.calibrations) || array_send(t.shared_jacobian_m) as shared_jacobian,
    ST_AsBinary(t.line, 'NDR') as line, t.line_cov, {{paint columns of t}}
from conetl.marking_track t
where t.drive_uuid = %(drive_uuid)s
order by t.marking_index;

-- name: paths_of_map
-- The paths of the active drives of a map, without points on straight lines.
-- Parameters: map_name; valid_until (timestamptz; 'infinity' = all): drives that began later are left out; tolerance_m.
-- Columns: drive_id, captured_from_ns, eastings_m, northings_m (arrays, map CRS, in order of time). A drive that did
-- not move has no row.
select
    d.drive_id, d.captured_from_ns,
    array_agg(ST_X(p.geom) order by p.path[1]) as eastings_m,
    array_agg(ST_Y(p.geom) order by p.path[1]) as northings_m
from conetl.active_drive d
join conetl.map m using (map_id)
cross join lateral (
    select ST_Simplify(ST_MakeLine(ST_Force2D(f.geom) order by f.frame_index), %(tolerance_m)s::float8) as line
    from conetl.frame_pair f
    where f.drive_uuid = d.drive_uuid
) l
cross join lateral ST_DumpPoints(l.line) p
where m.map_name = %(map_name)s and lower(d.captured_period) <= %(valid_until)s::timestamptz
and ST_NPoints(l.line) > 1
group by d.drive_uuid, d.drive_id, d.captured_from_ns
order by d.captured_from_ns, d.drive_id;

-- name: drives_at_the_same_time
-- The active drives with other content, not on hold, that may be the same recording: they were around a path while it was
-- driven; or, at any time, have the same id and length; or passed (to 1 m) the middle and the first or third quarter of the
-- shorter one at the same interval. A part of half the length contains the middle and one of the others.
-- Parameters: map_name; drive_id; captured_from_ns, captured_to_ns (UTC); frame_count; content_sha256; path_wkt (a line), srid;
-- at_ns, eastings_m, northings_m (arrays: its frame pairs, in order); same_ns: intervals differ by no more.
-- Columns: drive_uuid, drive_id, changeset_no, rig, is_alike (id and length).
with path as (select ST_GeomFromText(%(path_wkt)s, %(srid)s) as geom),
own as materialized (
    select p.at_ns, ST_Expand(ST_SetSRID(ST_MakePoint(p.easting_m, p.northing_m), %(srid)s), 1) as box, p.n
    from unnest(%(at_ns)s::bigint[], %(eastings_m)s::float8[], %(northings_m)s::float8[])
        with ordinality as p (at_ns, easting_m, northing_m, n)
),
own_quarters as materialized (  -- two frames of each, as one may be lost
    select q.quarter, o.at_ns, o.box
    from generate_series(1, 3) as q (quarter)
    join own o on o.n - q.quarter * cardinality(%(at_ns)s::bigint[]) / 4 in (1, 2)
)
select
    d.drive_uuid, d.drive_id, d.changeset_no, d.rig,
    d.drive_id = %(drive_id)s and d.expected_frame_count = %(frame_count)s as is_alike
from conetl.active_drive d
join conetl.map m on m.map_id = d.map_id
cross join path
where m.map_name = %(map_name)s and m.srid = %(srid)s and d.rig is not null
and d.content_sha256 <> %(content_sha256)s
and d.area && path.geom
and not exists (select from conetl.on_hold h where h.changeset_id = d.changeset_id)
and case
    when ST_SRID(d.area) <> %(srid)s then false  -- a drive on hold may have another CRS than the map
    when not ST_Intersects(d.area, path.geom) then false
    when d.drive_id = %(drive_id)s and d.expected_frame_count = %(frame_count)s then true
    when d.captured_from_ns <= %(captured_to_ns)s and d.captured_to_ns >= %(captured_from_ns)s then d.drive_id <> %(drive_id)s
    else exists (
        with near as materialized (
            select o.quarter, f.captured_at_ns - o.at_ns as off_ns
            from conetl.frame_pair f
            join own_quarters o on o.box && f.geom
            where f.drive_uuid = d.drive_uuid and d.expected_frame_count >= %(frame_count)s
            union all
            select q.quarter, f.captured_at_ns - o.at_ns
            from generate_series(1, 3) as q (quarter)
            join (
                select f.captured_at_ns, f.geom, row_number() over (order by f.frame_index) as n, count(*) over () as count
                from conetl.frame_pair f
                where f.drive_uuid = d.drive_uuid
            ) f on f.n - q.quarter * f.count / 4 in (1, 2)
            join own o on o.box && f.geom
            where d.expected_frame_count < %(frame_count)s
        )
        select
        from near a
        join near b on b.quarter <> 2 and abs(b.off_ns - a.off_ns) <= %(same_ns)s
        where a.quarter = 2
    )
end
order by d.changeset_no;

-- name: same_rig_elsewhere
-- The nearest active drive in time, within a day, of a rig that could not have driven from there to a path, or back.
-- Parameters: map_name; rig_id; drive_id; captured_from_ns, captured_to_ns (UTC); path_wkt (a line), srid; most_m_s: its speed;
-- apart_m: a distance that is always possible. Columns: drive_id, apart_m, apart_s (0: at the same time).
select d.drive_id, f.apart_m, t.apart_s
from conetl.active_drive d
join conetl.map m on m.map_id = d.map_id
cross join lateral (
    select greatest(d.captured_from_ns - %(captured_to_ns)s, %(captured_from_ns)s - d.captured_to_ns, 0) * 1e-9::float8 as apart_s
) t
cross join lateral (select ST_Distance(d.area, ST_GeomFromText(%(path_wkt)s, %(srid)s)) as apart_m) f
where m.map_name = %(map_name)s and m.srid = %(srid)s
and d.captured_from_ns < %(captured_to_ns)s + 86400000000000 and d.captured_to_ns > %(captured_from_ns)s - 86400000000000
and d.rig ->> 'rig_id' = %(rig_id)s and d.drive_id <> %(drive_id)s and ST_SRID(d.area) = %(srid)s
and f.apart_m > %(apart_m)s + %(most_m_s)s * t.apart_s
order by t.apart_s, d.captured_from_ns, d.drive_id
limit 1;

-- name: drives_with_boxes
-- The active drives with other content, not on hold, whose left images have the same size and the boxes of another drive's
-- images: with one constant time shift, in least_images of these images and for least_share of the boxes of their common
-- time.
-- Parameters: map_name; content_sha256; srid; width_px, height_px; at_ns, eastings_m, northings_m, x_px, y_px, w_px, h_px (arrays: the
-- boxes, with time and position of their images); within_m (of the positions), same_px (of each number), same_ns (of offsets);
-- least_images, least_share. Columns: drive_uuid, drive_id, changeset_no, rig, is_alike (false).
with box as materialized (
    select * from unnest(%(at_ns)s::bigint[], %(eastings_m)s::float8[], %(northings_m)s::float8[], %(x_px)s::float8[],
        %(y_px)s::float8[], %(w_px)s::float8[], %(h_px)s::float8[]) with ordinality as b (at_ns, easting_m, northing_m, x, y, w, h, n)
),
image as materialized (
    select b.at_ns,
        ST_Expand(ST_SetSRID(ST_MakePoint(min(b.easting_m), min(b.northing_m)), %(srid)s), %(within_m)s) as square
    from box b
    group by b.at_ns
)
select d.drive_uuid, d.drive_id, d.changeset_no, d.rig, false as is_alike
from conetl.active_drive d
join conetl.map m on m.map_id = d.map_id
where m.map_name = %(map_name)s and m.srid = %(srid)s and ST_SRID(d.area) = %(srid)s
and d.content_sha256 <> %(content_sha256)s
and (d.rig->'left'->>'width_px')::integer = %(width_px)s and (d.rig->'left'->>'height_px')::integer = %(height_px)s
and exists (select from image i where d.area && i.square)
and not exists (select from conetl.on_hold h where h.changeset_id = d.changeset_id)
and exists (
    with same as materialized (
        select b.n, b.at_ns, f.captured_at_ns - b.at_ns as off_ns
        from image i
        join conetl.frame_pair f on f.drive_uuid = d.drive_uuid and f.geom && i.square
        join box b on b.at_ns = i.at_ns
        join conetl.detection t on t.drive_uuid = d.drive_uuid and t.frame_index = f.frame_index and t.side = 'left'
        where greatest(abs(t.x_px - b.x), abs(t.y_px - b.y), abs(t.w_px - b.w), abs(t.h_px - b.h)) <= %(same_px)s
    ),
    alike as (
        select s.off_ns, count(distinct o.at_ns) as images, count(distinct o.n) as boxes
        from (select distinct off_ns from same) s
        join same o on o.off_ns between s.off_ns and s.off_ns + %(same_ns)s
        group by s.off_ns
    )
    select
    from alike a
    where a.images >= %(least_images)s and a.boxes >= %(least_share)s * (
        select count(*) from box b
        where b.at_ns + a.off_ns between d.captured_from_ns - %(same_ns)s and d.captured_to_ns + %(same_ns)s
    )
)
order by d.changeset_no;

-- name: adjoining_drives
-- The drives of other recordings that are active, or held by the map, and that ended just before, or began just after, some
-- drives; and these drives themselves if they are active or held.
-- Parameters: drive_uuids (uuid[], of one map); within_ns; check (JSON: a list of an object with its name).
-- Columns: of_uuid (one of drive_uuids), then as AdjoiningDrive.
select
    q.drive_uuid as of_uuid, d.drive_uuid, d.drive_id, d.rig, d.captured_from_ns,
    exists (select from conetl.on_hold h where h.changeset_id = d.changeset_id and h.checks @> %(check)s::jsonb) as on_hold,
    exists (select from conetl.active_decision a where a.changeset_id = d.changeset_id and a.kind = 'accept') as accepted
from conetl.drive q
cross join lateral (
    select l.drive_uuid
    from conetl.drive l
    where l.map_id = q.map_id and l.rig is not null
    and (
        l.captured_to_ns between q.captured_from_ns - %(within_ns)s and q.captured_from_ns
        or l.captured_from_ns between q.captured_to_ns and q.captured_to_ns + %(within_ns)s
    )
    and l.drive_id <> q.drive_id and l.content_sha256 <> q.content_sha256
    union all
    select q.drive_uuid where q.rig is not null
    offset 0
) near
cross join lateral (select a.* from conetl.active_drive a where a.drive_uuid = near.drive_uuid offset 0) d
where q.drive_uuid = any(%(drive_uuids)s)
order by d.captured_from_ns, d.content_sha256;

-- name: frame_pairs_at_ends
-- The first and the last frame pairs of some drives. Parameters: drive_uuids (uuid[]); count (at each end).
-- Columns: as frame_pairs, then drive_uuid; in the order of their time.
select {{frame_pair columns of p}}, p.drive_uuid
from (
    select
        f.*,
        row_number() over (partition by f.drive_uuid order by f.captured_at_ns, f.frame_index) as from_first,
        row_number() over (partition by f.drive_uuid order by f.captured_at_ns desc, f.frame_index desc) as from_last
    from conetl.frame_pair f
    where f.drive_uuid = any(%(drive_uuids)s)
) p
where p.from_first <= %(count)s or p.from_last <= %(count)s
order by p.drive_uuid, p.captured_at_ns, p.frame_index;

-- name: other_deliveries
-- Changesets of the same recording with other content that count: equal id, and the first or the last frame pair at the
-- same nanosecond. Imported maps, which have no rig, are not recordings.
-- Parameters: map_name; drive_id; captured_from_ns, captured_to_ns (UTC); content_sha256. Columns: changeset_no.
select d.changeset_no
from conetl.active_drive d
join conetl.map m on m.map_id = d.map_id
where m.map_name = %(map_name)s and d.rig is not null and d.drive_id = %(drive_id)s
and (d.captured_from_ns = %(captured_from_ns)s or d.captured_to_ns = %(captured_to_ns)s)
and d.content_sha256 <> %(content_sha256)s
and not exists (select from conetl.on_hold h where h.changeset_id = d.changeset_id)
order by d.changeset_no;
