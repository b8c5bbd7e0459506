-- Purpose: how far every map has come, cheap enough to be asked several times a second.
-- Columns: map_name; changeset_no, decision_no (the newest ones of the map, 0 where there is none); base (a text that differs where
-- the imported base layers differ).
select
    m.map_name,
    coalesce((select max(c.changeset_no) from conetl.changeset c where c.map_id = m.map_id), 0) as changeset_no,
    coalesce((select max(d.decision_no) from conetl.decision d where d.map_id = m.map_id), 0) as decision_no,
    coalesce(
        (select md5(string_agg(s.source_id::text, ' ' order by s.source_id)) from conetl.base_source s where s.map_id = m.map_id),
        'none'
    ) as base
from conetl.map m;
