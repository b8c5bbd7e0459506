-- Drives on hold are stored and change nothing on the map until a person accepts them. A recording that contradicts itself is held once
-- (by_map false) and takes part in no comparison; one that contradicts the map (by_map) is compared again with every drive before it.
create table conetl.hold (
    hold_id       uuid primary key default gen_random_uuid(),
    changeset_id  uuid not null references conetl.changeset,
    by_map        boolean not null,
    reason        text not null check (reason <> ''),
    system_period tstzrange not null check (not isempty(system_period))
);
create unique index hold_open on conetl.hold (changeset_id) where upper_inf(system_period);

alter table conetl.decision drop constraint decision_kind_check;
alter table conetl.decision drop constraint decision_check2;
alter table conetl.decision add constraint decision_kind_check
    check (kind in ('suppress', 'pin', 'revert', 'accept', 'withdraw'));
alter table conetl.decision add constraint decision_check2
    check ((kind in ('revert', 'accept')) = (changeset_id is not null));

create view conetl.discounted as
select a.changeset_id
from conetl.active_decision a
where a.kind = 'revert'
union
select h.changeset_id
from conetl.hold h
where upper_inf(h.system_period) and not h.by_map
and not exists (select from conetl.active_decision a where a.changeset_id = h.changeset_id and a.kind = 'accept');
comment on view conetl.discounted is 'Changesets that were reverted, or whose recording is on hold.';

create or replace view conetl.active_drive as
select d.*, c.changeset_id, c.changeset_no, c.idempotency_key
from conetl.changeset c
join conetl.drive d using (drive_uuid)
where not exists (select from conetl.discounted r where r.changeset_id = c.changeset_id)
and not exists (
    select
    from conetl.drive other
    join conetl.changeset newer on newer.drive_uuid = other.drive_uuid
    where other.map_id = d.map_id and other.content_sha256 = d.content_sha256 and newer.changeset_no > c.changeset_no
    and not exists (select from conetl.discounted r where r.changeset_id = newer.changeset_id)
);

create view conetl.on_hold as
select h.hold_id, c.map_id, h.changeset_id, h.reason, lower(h.system_period) as since
from conetl.hold h
join conetl.changeset c using (changeset_id)
where upper_inf(h.system_period)
and case
    when h.by_map then exists (select from conetl.active_drive a where a.changeset_id = h.changeset_id)
    else not exists (
        select from conetl.active_decision a where a.changeset_id = h.changeset_id and a.kind in ('revert', 'accept')
    )
end;
comment on view conetl.on_hold is 'Drives that wait for a person, and why.';
