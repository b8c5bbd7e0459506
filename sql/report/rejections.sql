-- Purpose: refused records of a changeset by step and reason, the most frequent first, each with the first of them as an example.
-- Parameters: changeset_id. Columns: step, reason, count, record, detail.
select step, reason, count(*) as count,
    (array_agg(record order by quarantine_id))[1] as record, (array_agg(detail order by quarantine_id))[1] as detail
from conetl.quarantine
where changeset_id = %(changeset_id)s
group by step, reason
order by count desc, step, reason;
