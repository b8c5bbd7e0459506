-- Purpose: the base layers of a map, file by file. Parameters: map_name.
-- Columns: source_id, layer_name, kind, kept_count.
select s.source_id, s.layer_name, s.kind, s.kept_count
from conetl.base_source s
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by s.layer_name, s.source_id;
