-- Purpose: let a new session read what PROJ needs for the maps' coordinate reference systems. No parameters. Columns: place (text, any).
select ST_AsGeoJSON(ST_Transform(ST_Centroid(d.area), 4326)) as place
from (select distinct on (srid) area from conetl.drive order by srid) d;
