-- Purpose: found the features that are new. Parameters: map_id, srid, changeset_id.
insert into conetl.feature (feature_id, map_id, srid, founded_by, cell)
select s.feature_id, %(map_id)s, %(srid)s, %(changeset_id)s, conetl.place_cell(s.geom)
from delta_stage s
where s.kind in ('added', 'split')
on conflict (feature_id) where map_id > 0 do nothing;
