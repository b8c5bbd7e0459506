-- Purpose: how many cones stood on a map after each instant at which that changed, as the database knew it then. Parameters: map_name.
-- Columns: at, standing.
-- A row of feature_version that stands with an open end on the road is on the map as long as the database believes it.
with steps as (
    select e.at, sum(e.change) as change
    from conetl.feature_version v
    join conetl.map m using (map_id)
    cross join lateral (
        values (lower(v.system_period), 1), (upper(v.system_period), -1)
    ) e (at, change)
    where m.map_name = %(map_name)s and v.present and upper_inf(v.valid_period) and e.at is not null
    group by e.at
)

select at, sum(change) over (order by at)::bigint as standing
from steps
order by at;
