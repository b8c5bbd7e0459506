-- Purpose: which of some ids features of this database have, and where they stand or stood last. Parameters: feature_ids (uuid[]).
-- Columns: feature_id, map_name, easting_m, northing_m (of what is believed now; null where nothing is).
select f.feature_id, m.map_name, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m
from conetl.feature f
join conetl.map m using (map_id)
left join conetl.feature_version v
    on v.cell = f.cell and v.feature_id = f.feature_id and upper_inf(v.system_period) and upper_inf(v.valid_period)
where f.feature_id = any(%(feature_ids)s) and f.map_id > 0
order by f.feature_id;
