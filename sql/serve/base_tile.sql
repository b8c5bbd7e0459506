-- Purpose: the bytes of one tile of a map. Parameters: map_name; sha256. Columns: payload.
select t.payload
from conetl.base_tile t
join conetl.base_source s using (source_id)
join conetl.map m using (map_id)
where t.sha256 = %(sha256)s and m.map_name = %(map_name)s
limit 1;
