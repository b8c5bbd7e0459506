-- Of several deliveries of one recording only the latest may count, whatever puts one on hold or releases it. A hold keeps its checks
-- with their figures, and a receipt says whether its drive went on hold.
alter table conetl.hold add column checks jsonb;
update conetl.hold h
set checks = coalesce(
    (
        select jsonb_agg(k.value)
        from conetl.changeset c
        join conetl.run r using (run_id)
        cross join jsonb_array_elements(r.facts -> 'health') k
        where c.changeset_id = h.changeset_id and not h.by_map and k.value ->> 'verdict' = 'hold'
    ),
    jsonb_build_array(jsonb_build_object(
        'name', case when h.by_map then 'agreement with the map' else 'recording' end,
        'verdict', 'hold', 'value', null, 'detail', h.reason
    ))
);
alter table conetl.hold alter column checks set not null;
alter table conetl.hold add check (jsonb_array_length(checks) > 0);
comment on column conetl.hold.checks is 'The health checks that did not pass, with value, sigma, limit and unit; reason is their text.';

create view conetl.newer_delivery as
select c.changeset_id, newer.changeset_id as newer_id, newer.changeset_no as newer_no
from conetl.changeset c
join conetl.drive d using (drive_uuid)
join conetl.drive other on other.map_id = d.map_id and other.content_sha256 = d.content_sha256
join conetl.changeset newer on newer.drive_uuid = other.drive_uuid and newer.changeset_no > c.changeset_no
union all
select c.changeset_id, newer.changeset_id, newer.changeset_no
from conetl.changeset c
join conetl.drive d using (drive_uuid)
join conetl.drive other on other.map_id = d.map_id and other.drive_id = d.drive_id and other.content_sha256 <> d.content_sha256
    and (other.captured_from_ns = d.captured_from_ns or other.captured_to_ns = d.captured_to_ns)
join conetl.changeset newer on newer.drive_uuid = other.drive_uuid and newer.changeset_no > c.changeset_no
where d.rig is not null and other.rig is not null;
comment on view conetl.newer_delivery is
    'Later analyses and deliveries of the recording of a changeset; a recording is known by its content, or by id and instants.';

-- Written out, and not by newer_delivery: where few drives are asked for, each is looked up by an index.
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
)
and not exists (
    select
    from conetl.drive other
    join conetl.changeset newer on newer.drive_uuid = other.drive_uuid
    where d.rig is not null and other.rig is not null and other.map_id = d.map_id and other.drive_id = d.drive_id
    and (other.captured_from_ns = d.captured_from_ns or other.captured_to_ns = d.captured_to_ns)
    and newer.changeset_no > c.changeset_no
    and not exists (select from conetl.discounted r where r.changeset_id = newer.changeset_id)
);
comment on view conetl.active_drive is
    'The drives that make the map: not reverted, and of each recording the analysis and delivery that was ingested last.';

create or replace view conetl.on_hold as
select h.hold_id, c.map_id, h.changeset_id, h.reason, lower(h.system_period) as since, h.checks
from conetl.hold h
join conetl.changeset c using (changeset_id)
where upper_inf(h.system_period)
and case
    when h.by_map then exists (select from conetl.active_drive a where a.changeset_id = h.changeset_id)
    else not exists (
        select from conetl.active_decision a where a.changeset_id = h.changeset_id and a.kind in ('revert', 'accept')
    ) and not exists (
        select
        from conetl.newer_delivery n
        where n.changeset_id = h.changeset_id
        and not exists (select from conetl.active_decision a where a.changeset_id = n.newer_id and a.kind = 'revert')
    )
end;
comment on view conetl.on_hold is 'Drives that wait for a person, and why; not those that a later delivery replaced.';

alter table conetl.receipt drop constraint receipt_state_check;
alter table conetl.receipt drop constraint receipt_check;
alter table conetl.receipt add constraint receipt_state_check
    check (state in ('started', 'committed', 'held', 'known', 'failed', 'crashed'));
alter table conetl.receipt add constraint receipt_check
    check ((state in ('committed', 'held', 'known')) = (changeset_id is not null));
