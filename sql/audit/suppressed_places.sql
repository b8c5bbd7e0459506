-- Purpose: what is believed to stand at a place that a person suppressed is suppressed, in every version, and nothing else is.
-- Columns: feature_id, version, problem.
-- A micrometre about the edge of a place is left out of account: two programs compare distances with radii there.
with place as (
    select map_id, geom, radius_m from conetl.active_decision where kind = 'suppress'
)
select v.feature_id, v.version, 'is suppressed, but at no suppressed place' as problem
from conetl.feature_version v
where v.suppressed and upper_inf(v.system_period)
and not exists (select from place p where p.map_id = v.map_id and ST_DWithin(v.geom, p.geom, p.radius_m + 1e-6))
union
select v.feature_id, v.version, 'stands at a suppressed place, but is not suppressed'
from place p
join conetl.feature_version v on v.map_id = p.map_id and ST_DWithin(v.geom, p.geom, greatest(p.radius_m - 1e-6, 0))
where v.present and upper_inf(v.system_period);
