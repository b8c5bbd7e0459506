-- Purpose: features of a map by the beginning of their id, standing or removed; at most two, which is enough to see that it is
-- ambiguous.
-- Parameters: map_name (text), beginning (text, lower case, no wildcard characters)
-- Columns: feature_id (uuid)
select f.feature_id
from conetl.feature f
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and starts_with(f.feature_id::text, %(beginning)s)
order by f.feature_id
limit 2;
