-- What other systems are notified of: how work zones begin, change and end, and differences between plans and the map.

create table conetl.notice (
    notice_no   bigint generated always as identity primary key,
    map_id      integer not null references conetl.map (map_id),
    topic       text not null check (topic in ('work_zone', 'plan_difference')),
    subject_id  uuid not null,
    event       text not null check (event in ('began', 'changed', 'ended', 'withdrawn')),
    state       jsonb not null,
    recorded_at timestamptz not null default now()
);
create index notice_by_subject on conetl.notice (map_id, topic, subject_id, notice_no);
comment on table conetl.notice is
    'Versions of work zones and of differences from plans, as they were found when the map was compared with its last ones.';
comment on column conetl.notice.subject_id is 'The work zone, or the difference.';
comment on column conetl.notice.event is 'withdrawn: a late drive or a decision changed the history, and it never was.';

create table conetl.notice_round (
    map_id     integer primary key references conetl.map (map_id) on delete cascade,
    seen_at    timestamptz not null,
    checked_at timestamptz not null
);
comment on table conetl.notice_round is 'When the notices of a map were recorded last, and the newest commit, plan or verdict then.';

create table conetl.notice_receiver (
    receiver  text not null,
    map_id    integer not null references conetl.map (map_id) on delete cascade,
    after_no  bigint not null,
    primary key (receiver, map_id)
);
comment on table conetl.notice_receiver is
    'Who is notified of a map: a host and the beginning of the hash of its address, which may hold a secret; or Prefect.';
comment on column conetl.notice_receiver.after_no is 'The last notice before it was added: of older ones it gets what still holds.';

create table conetl.notice_delivery (
    receiver     text not null,
    notice_no    bigint not null references conetl.notice (notice_no) on delete cascade,
    attempts     integer not null check (attempts > 0),
    first_at     timestamptz not null,
    next_at      timestamptz,
    delivered_at timestamptz,
    given_up_at  timestamptz,
    problem      text,
    primary key (receiver, notice_no),
    check ((next_at is null) = (delivered_at is not null or given_up_at is not null))
);
create index notice_delivery_open on conetl.notice_delivery (notice_no) where delivered_at is null;
comment on table conetl.notice_delivery is 'Attempts to notify a receiver, the last one of each; it is no history and may be changed.';
