-- Purpose: drop a base layer with all its files. Parameters: map_name; layer_name. Columns: kept_count of each file.
delete from conetl.base_source s
using conetl.map m
where m.map_id = s.map_id and m.map_name = %(map_name)s and s.layer_name = %(layer_name)s
returning s.kept_count;
