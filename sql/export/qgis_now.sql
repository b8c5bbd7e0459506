-- Purpose: layer of a QGIS project: what stands now, and what stood last where a cone was removed or merged into another, with what made it so.
-- Parameters: map_name. Columns: as below (metres, UTC); sigma_m is the mean horizontal one;
-- seen_count, missed_count: drives that saw it and that looked in vain, existence_probability is that after them.
select
    v.version_row_id, v.feature_id::text as feature_id, v.version, x.kind as change, v.category, coalesce(e.existence_after, v.existence_probability) as existence_probability,
    e.seen_count, e.missed_count,
    v.cone_height_m as height_m, sqrt((v.cov_xx + v.cov_yy) / 2) as sigma_m, v.observation_count,
    to_timestamp(v.first_seen_ns / 1e9) as first_seen_at, to_timestamp(v.last_seen_ns / 1e9) as last_seen_at,
    lower(v.valid_period) as valid_from, upper(v.valid_period) as valid_to, v.geom
from conetl.feature_version v
join conetl.map m using (map_id)
join conetl.delta x on x.changeset_id = v.changeset_id and x.feature_id = v.feature_id and upper_inf(x.system_period)
cross join lateral conetl.feature_evidence(v.feature_id, v.version) e
where m.map_name = %(map_name)s and upper_inf(v.system_period) and upper_inf(v.valid_period)
and (v.present or x.kind in ('removed', 'merged'))
;
