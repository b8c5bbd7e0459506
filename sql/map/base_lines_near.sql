-- Purpose: lines of a map's base layers that come near to places. Parameters: map_name;
-- west_m, south_m, east_m, north_m (float8[] of equal lengths, map CRS): a box each place.
-- Columns: box (from 0), layer_name, kind, attributes, geom (well-known binary, easting and northing); a line stands once for each box it meets.
select b.number - 1 as box, s.layer_name, l.kind, l.attributes, ST_AsBinary(ST_Force2D(l.geom)) as geom
from unnest(%(west_m)s::float8[], %(south_m)s::float8[], %(east_m)s::float8[], %(north_m)s::float8[])
    with ordinality as b (west_m, south_m, east_m, north_m, number)
cross join conetl.map m
join conetl.base_source s on s.map_id = m.map_id and s.kind = 'lines'
join conetl.base_line l on l.source_id = s.source_id
    and l.geom && ST_MakeEnvelope(b.west_m, b.south_m, b.east_m, b.north_m, m.srid)
where m.map_name = %(map_name)s
order by b.number, l.line_id;
