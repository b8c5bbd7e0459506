-- Purpose: the open versions, of any map, of staged features that do not stand around the drive: conflicts are looked for next. As a rule
-- these are the new ones, which have none. They are looked for by their ids, which lie all over the index, as those of new
-- features must be anyway. offset 0: one look into feature_version_believed each, whatever the planner thinks of the tables' sizes; it
-- would read the whole table, or go through the exclusion constraint's index, which takes a dozen pages each.
insert into open_version
select v.*
from delta_stage s
join lateral (select f.cell from conetl.feature f where f.feature_id = s.feature_id and f.map_id > 0 offset 0) f on true
cross join lateral (
    select
        w.feature_id, w.cell, w.map_id, w.version_row_id, w.version, w.present or w.suppressed,
        lower(w.valid_period), w.valid_from_ns
    from conetl.feature_version w
    where w.cell = f.cell and w.feature_id = s.feature_id
    and coalesce(upper(w.system_period), 'infinity') = 'infinity' and upper_inf(w.valid_period)
    offset 0
) v
where not exists (select from open_version o where o.feature_id = s.feature_id);
