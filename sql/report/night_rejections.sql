-- Purpose: refused records of all drives committed in a span, by step and reason. Parameters: map_name, since, until.
-- Columns: step, reason, count, drives.
select q.step, q.reason, count(*) as count, count(distinct c.changeset_id) as drives
from conetl.quarantine q
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and c.committed_at >= %(since)s and c.committed_at < %(until)s
group by q.step, q.reason
order by count desc, q.step, q.reason;
