-- Purpose: the lines of a map's base layers. Parameters: map_name; max_rows.
-- Columns: layer_name, kind, subtype (null where the file has none), geom (well-known binary).
select s.layer_name, l.kind, l.attributes ->> 'subtype' as subtype, ST_AsBinary(l.geom) as geom
from conetl.base_line l
join conetl.base_source s using (source_id)
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
order by l.line_id
limit %(max_rows)s;
