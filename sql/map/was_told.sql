-- Purpose: whether a changeset's events were handed to Prefect. Parameters: changeset_id (uuid). Columns: was_told (boolean).
select exists (select 1 from conetl.changeset_told t where t.changeset_id = %(changeset_id)s) as was_told;
