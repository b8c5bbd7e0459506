-- Purpose: where and from when on a map holds something. Parameters: $1 map name.
-- Columns: west, south, east, north (degrees; around all that drives looked at), since (beginning of the first drive).
select
    ST_XMin(a.box) as west, ST_YMin(a.box) as south, ST_XMax(a.box) as east, ST_YMax(a.box) as north, a.since
from (
    select
        ST_Extent(ST_Transform(ST_Segmentize(e.edges, greatest(ST_Perimeter(e.edges) / 64, 1)), 4326)) as box,
        min(e.since) as since
    from (
        select ST_Envelope(d.area) as edges, lower(d.captured_period) as since
        from conetl.drive d
        join conetl.map m using (map_id)
        where m.map_name = $1
    ) e
) a;
