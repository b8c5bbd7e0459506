-- Purpose: the refused records of a changeset. Parameters: changeset_id, max_rows (null: all).
-- Columns: step, reason, record, detail, payload.
select step, reason, record, detail, payload
from conetl.quarantine
where changeset_id = %(changeset_id)s
order by quarantine_id
limit %(max_rows)s;
