-- Purpose: has this file been imported with these parameters? Parameters: map_name; layer_name; content_sha256; params (JSON).
-- Columns: source_id, kept_count, source_path.
select s.source_id, s.kept_count, s.source_path
from conetl.base_source s
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and s.layer_name = %(layer_name)s and s.content_sha256 = %(content_sha256)s
and s.params = %(params)s::jsonb;
