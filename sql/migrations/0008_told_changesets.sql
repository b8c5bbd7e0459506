-- Purpose: which changesets were told to Prefect as events. A run that is killed between its commit and its events leaves a changeset
-- without a row here; whoever takes the drive again tells it then. Append-only.

create table conetl.changeset_told (
    changeset_id uuid primary key references conetl.changeset,
    told_at      timestamptz not null default clock_timestamp()
);
comment on table conetl.changeset_told is 'Changesets whose events were handed to Prefect.';

-- What was committed before this table existed is taken as told: an alarm about a drive of last month helps nobody.
insert into conetl.changeset_told (changeset_id, told_at) select c.changeset_id, c.committed_at from conetl.changeset c;
