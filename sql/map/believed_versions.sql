-- Purpose: every version of every feature of a map that is believed now and began no later than an instant, ended ones too.
-- Parameters: map_name; valid_until (timestamptz; 'infinity' = all). Columns: as FeatureVersion, valid_to_ns to the microsecond.
select
    v.feature_id, v.version, v.category, ST_X(v.geom), ST_Y(v.geom), ST_Z(v.geom),
    v.cov_xx, v.cov_xy, v.cov_xz, v.cov_yy, v.cov_yz, v.cov_zz,
    ST_X(v.centre_geom), ST_Y(v.centre_geom), ST_Z(v.centre_geom),
    v.cone_height_m, v.cone_height_sigma_m, v.existence_probability, v.observation_count, v.first_seen_ns, v.last_seen_ns,
    array_send(v.calibrations) || array_send(v.shared_jacobian_m),
    v.changeset_id, v.present or v.suppressed, v.suppressed, v.valid_from_ns,
    case
        when upper_inf(v.valid_period) then null
        else (extract(epoch from upper(v.valid_period)) * 1000000)::bigint * 1000
    end
from conetl.feature_version v
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and upper_inf(v.system_period) and lower(v.valid_period) <= %(valid_until)s::timestamptz
order by v.feature_id, v.version;
