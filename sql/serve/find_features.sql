-- Purpose: features of a map by the beginning of their id, standing or removed.
-- Parameters: map_name; beginning (lower case); max_rows. Columns: feature_id.
select f.feature_id
from conetl.feature f
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and starts_with(f.feature_id::text, %(beginning)s)
order by f.feature_id
limit %(max_rows)s;
