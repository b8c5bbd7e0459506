-- Purpose: all maps of this database. Columns: map_name, srid.
select map_name, srid from conetl.map order by map_name;
