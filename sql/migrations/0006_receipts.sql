-- Purpose: what became of every drive that was handed over: one row when work on it starts, one when it ends. Append-only.
--
-- An attempt that started, has not ended, and whose lock nobody holds (map/held_locks.sql) was interrupted. A drive is known by
-- header_sha256, which needs none of its pictures: its id, calibration, time stamps, first poses and the names of its files.

create table conetl.receipt (
    receipt_no      bigint generated always as identity primary key,
    attempt_id      uuid not null,
    map_name        text not null check (map_name ~ '^[a-z0-9_-]{1,40}$'),  -- no foreign key: the first drive makes the map
    drive_path      text not null,
    drive_id        text not null,
    header_sha256   text not null check (header_sha256 ~ '^[0-9a-f]{64}$'),
    analysis_sha256 text not null check (analysis_sha256 ~ '^[0-9a-f]{64}$'),  -- parameters and model
    content_sha256  text check (content_sha256 ~ '^[0-9a-f]{64}$'),            -- null where the drive could not be read
    state           text not null check (state in ('started', 'committed', 'known', 'failed', 'crashed')),
    reason          text not null,        -- of failed and crashed: why; of committed: what to look at, else ''
    may_pass        boolean not null,     -- trying again may help although the drive is the same
    changeset_id    uuid references conetl.changeset,
    frame_pairs     integer check (frame_pairs >= 0),
    seconds         float8 check (seconds >= 0),
    flow_run_id     text,
    host            text not null,
    at              timestamptz not null default clock_timestamp(),
    check ((state in ('committed', 'known')) = (changeset_id is not null)),
    check (state not in ('failed', 'crashed') or reason <> '')
);
create unique index receipt_of_attempt on conetl.receipt (attempt_id, (state = 'started'));
create index receipt_by_drive on conetl.receipt (map_name, header_sha256, receipt_no desc);
comment on table conetl.receipt is 'What became of every drive that was handed over; two rows an attempt: started, and how it ended.';

create view conetl.latest_receipt as
select distinct on (map_name, header_sha256) *
from conetl.receipt
order by map_name, header_sha256, receipt_no desc;
comment on view conetl.latest_receipt is 'The last word on every drive; started and no lock held: it was interrupted.';
