-- Purpose: a box in the CRS of a map that surely holds a box in degrees. Parameters: $1, $2, $3, $4 west, south, east, north; $5 SRID.
-- Columns: min_x_m, min_y_m, max_x_m, max_y_m. The edges are bent there, so they are looked at in 16 pieces each.
select
    ST_XMin(b.box) - b.spare_m as min_x_m, ST_YMin(b.box) - b.spare_m as min_y_m,
    ST_XMax(b.box) + b.spare_m as max_x_m, ST_YMax(b.box) + b.spare_m as max_y_m
from (
    select t.box, 1 + 0.01 * greatest(ST_XMax(t.box) - ST_XMin(t.box), ST_YMax(t.box) - ST_YMin(t.box)) as spare_m
    from (
        select Box2D(ST_Transform(
            ST_Segmentize(ST_MakeEnvelope($1, $2, $3, $4, 4326), greatest($3 - $1, $4 - $2, 1e-6::float8) / 16), $5::integer
        )) as box
    ) t
) b;
