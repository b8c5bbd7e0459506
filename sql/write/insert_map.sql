-- Purpose: make a map unless it is there. Parameters: map_name, srid, created_at.
insert into conetl.map (map_name, srid, created_at) values (%(map_name)s, %(srid)s, %(created_at)s)
on conflict (map_name) do nothing;
