-- Purpose: what drives show that are being recorded, or are not ingested yet. Parameters: map_name.
-- Columns: drive_id, watch_id, ended_at (null: being watched, or its watcher died), feature_index, srid, easting_m, northing_m, height_m,
-- cov_xx, cov_xy, cov_yy (m^2), cone_height_m, existence_probability, observation_count, first_seen_ns, last_seen_ns,
-- near_feature_id (null: no standing feature near), updated_at.
select
    w.drive_id, w.watch_id, w.ended_at, p.feature_index, p.srid,
    ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as height_m, p.cov_xx, p.cov_xy, p.cov_yy, p.cone_height_m,
    p.existence_probability, p.observation_count, p.first_seen_ns, p.last_seen_ns, p.near_feature_id, p.updated_at
from conetl.provisional_feature p
join conetl.watched_drive w using (watch_id)
where w.map_name = %(map_name)s
order by w.started_at, w.watch_id, p.feature_index;
