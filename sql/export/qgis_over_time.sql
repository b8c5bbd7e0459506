-- Purpose: layer of a QGIS project: all that ever stood, as believed now, for the temporal controller.
-- Parameters: map_name. Columns: as below (metres, UTC); sigma_m is the mean horizontal one.
select
    v.version_row_id, v.feature_id::text as feature_id, v.version, x.kind as change, v.category, v.existence_probability,
    v.cone_height_m as height_m, sqrt((v.cov_xx + v.cov_yy) / 2) as sigma_m, v.observation_count,
    to_timestamp(v.first_seen_ns / 1e9) as first_seen_at, to_timestamp(v.last_seen_ns / 1e9) as last_seen_at,
    lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to, v.geom
from conetl.feature_version v
join conetl.map m using (map_id)
join conetl.delta x on x.changeset_id = v.changeset_id and x.feature_id = v.feature_id and upper_inf(x.system_period)
where m.map_name = %(map_name)s and upper_inf(v.system_period)
and (v.present or x.kind in ('removed', 'merged'))
;
