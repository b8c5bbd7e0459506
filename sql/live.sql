-- Watched drives and their provisional features, which are not part of the map.

-- name: upsert_watched_drive
-- A drive that is being watched, with the frame pairs processed so far. Parameters: as the columns.
insert into conetl.watched_drive (
    watch_id, map_name, srid, drive_id, source_path, captured_from_ns, captured_to_ns, frame_pair_count
)
values (
    %(watch_id)s, %(map_name)s, %(srid)s, %(drive_id)s, %(source_path)s, %(captured_from_ns)s, %(captured_to_ns)s,
    %(frame_pair_count)s
)
on conflict (watch_id) do update
set captured_to_ns = excluded.captured_to_ns, frame_pair_count = excluded.frame_pair_count, updated_at = clock_timestamp();

-- name: upsert_provisional_feature
-- A cone as the watched drive shows it now. Parameters: as the columns; map_name; east_m, north_m, height_m; reach_m: the
-- nearest standing feature of the map within it may be the same cone.
insert into conetl.provisional_feature (
    watch_id, feature_index, srid, geom, cov_xx, cov_xy, cov_xz, cov_yy, cov_yz, cov_zz, object_height_m, existence_probability,
    observation_count, first_seen_ns, last_seen_ns, near_feature_id
)
select
    %(watch_id)s, %(feature_index)s, %(srid)s, p.geom, %(cov_xx)s, %(cov_xy)s, %(cov_xz)s, %(cov_yy)s, %(cov_yz)s, %(cov_zz)s,
    %(object_height_m)s, %(existence_probability)s, %(observation_count)s, %(first_seen_ns)s, %(last_seen_ns)s,
    (
        select f.feature_id
        from conetl.current_feature f
        where f.map_name = %(map_name)s and f.line is null and ST_SRID(f.geom) = %(srid)s and f.geom && ST_Expand(p.geom, %(reach_m)s)
        and ST_Distance(f.geom, p.geom) <= %(reach_m)s
        order by ST_Distance(f.geom, p.geom), f.feature_id
        limit 1
    )
from (select ST_SetSRID(ST_MakePoint(%(east_m)s, %(north_m)s, %(height_m)s), %(srid)s) as geom) p
on conflict (watch_id, feature_index) do update
set geom = excluded.geom, cov_xx = excluded.cov_xx, cov_xy = excluded.cov_xy, cov_xz = excluded.cov_xz, cov_yy = excluded.cov_yy,
    cov_yz = excluded.cov_yz, cov_zz = excluded.cov_zz, object_height_m = excluded.object_height_m,
    existence_probability = excluded.existence_probability, observation_count = excluded.observation_count,
    first_seen_ns = excluded.first_seen_ns, last_seen_ns = excluded.last_seen_ns, near_feature_id = excluded.near_feature_id,
    updated_at = clock_timestamp();

-- name: drop_provisional_feature
-- Withdraw a cone that the watched drive does not show any more. Parameters: watch_id; feature_index.
delete from conetl.provisional_feature where watch_id = %(watch_id)s and feature_index = %(feature_index)s;

-- name: end_watch
-- Mark a watched drive as ended; its provisional features stay until it is ingested. Parameters: watch_id.
update conetl.watched_drive set ended_at = clock_timestamp() where watch_id = %(watch_id)s;

-- name: provisional_features
-- Provisional features of drives that are being recorded, or are not ingested yet. Parameters: map_name.
-- Columns: as below (metres, m^2, UTC ns); ended_at is null while it is watched, or where its watcher died; near_feature_id
-- is null where no standing feature is near.
select
    w.drive_id, w.watch_id, w.ended_at, p.feature_index, p.srid,
    ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as ellipsoidal_height_m, p.cov_xx, p.cov_xy, p.cov_yy, p.object_height_m,
    p.existence_probability, p.observation_count, 
    timestamptz 'epoch' + p.last_seen_ns / 1000 * interval '1 microsecond' as last_seen_at, p.first_seen_ns, p.near_feature_id,
    p.updated_at
from conetl.provisional_feature p
join conetl.watched_drive w using (watch_id)
where w.map_name = %(map_name)s
order by w.started_at, w.watch_id, p.feature_index;

-- name: watches_to_drop
-- Watched drives of a map that a new watch may replace: of the same drive, without an end, or older than keep_days.
-- Parameters: map_name; drive_id; keep_days. Columns: watch_id, drive_id.
select w.watch_id, w.drive_id
from conetl.watched_drive w
where w.map_name = %(map_name)s
and (w.drive_id = %(drive_id)s or w.ended_at is null or w.updated_at < now() - make_interval(days => %(keep_days)s));

-- name: drop_watches
-- Remove watched drives with their provisional features. Parameters: watch_ids (uuid[]).
delete from conetl.watched_drive where watch_id = any(%(watch_ids)s::uuid[]);

-- name: drop_watched_recording
-- Remove what was shown of a drive while it was recorded, now that it is on the map.
-- Parameters: map_name; drive_id; captured_from_ns, captured_to_ns (UTC ns): another recording of the same name is left
-- alone.
delete from conetl.watched_drive
where map_name = %(map_name)s and drive_id = %(drive_id)s
and captured_from_ns <= %(captured_to_ns)s and captured_to_ns >= %(captured_from_ns)s;
