-- Purpose: found the features of staged versions that were never known. Parameters: map_id, srid.
insert into conetl.feature (feature_id, map_id, srid, founded_by, cell)
select s.feature_id, %(map_id)s, %(srid)s, s.changeset_id, conetl.place_cell(s.geom)
from version_stage s
where s.version = 1
on conflict (feature_id) where map_id > 0 do nothing;
