-- Purpose: the tracks of a drive. Parameters: drive_uuid. Columns: as Track (metres, m^2, ns); members as (frame, match) pairs in a
-- two-dimensional array; at last calibrations and shared_jacobian_m as PostgreSQL sends them, one after the other.
select
    t.track_index, t.category, ST_X(t.geom), ST_Y(t.geom), ST_Z(t.geom),
    t.cov_xx, t.cov_xy, t.cov_xz, t.cov_yy, t.cov_yz, t.cov_zz,
    t.relative_cov_xx, t.relative_cov_xy, t.relative_cov_xz, t.relative_cov_yy, t.relative_cov_yz, t.relative_cov_zz,
    ST_X(t.centre_geom), ST_Y(t.centre_geom), ST_Z(t.centre_geom),
    t.cone_height_m, t.cone_height_sigma_m, t.existence_probability, t.observation_count, t.first_seen_ns, t.last_seen_ns,
    t.residual_rms_px, t.nearest_range_m,
    (
        select array_agg(array[m.frame_index, m.match_index] order by m.frame_index, m.match_index)
        from conetl.track_member m
        where m.drive_uuid = t.drive_uuid and m.track_index = t.track_index
    ),
    array_send(t.calibrations) || array_send(t.shared_jacobian_m)
from conetl.track t
where t.drive_uuid = %(drive_uuid)s
order by t.track_index;
