-- Purpose: what an earlier state of the same file left in the layer. Parameters: map_name; layer_name; source_path; source_id (stays).
delete from conetl.base_source s
using conetl.map m
where m.map_id = s.map_id and m.map_name = %(map_name)s and s.layer_name = %(layer_name)s
and s.source_path = %(source_path)s and s.source_id <> %(source_id)s;
