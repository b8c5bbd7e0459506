-- Purpose: how many records were refused, by step and reason. Parameters: changeset_id. Columns: step, reason, count.
select step, reason, count(*) as count
from conetl.quarantine
where changeset_id = %(changeset_id)s
group by step, reason
order by step, reason;
