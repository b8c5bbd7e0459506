-- Purpose: remember that a changeset's events were handed to Prefect. Parameters: changeset_id (uuid).
insert into conetl.changeset_told (changeset_id) values (%(changeset_id)s) on conflict do nothing;
