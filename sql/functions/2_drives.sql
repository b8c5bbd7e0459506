-- Decisions in force, drives on hold, and which drives make the map.

create or replace view conetl.active_decision as
select d.*
from conetl.decision d
where d.kind <> 'withdraw' and not exists (select from conetl.decision w where w.withdraws = d.decision_id);
comment on view conetl.active_decision is 'Decisions that were not withdrawn.';

create or replace view conetl.discounted as
select a.changeset_id
from conetl.active_decision a
where a.kind = 'revert'
union
select h.changeset_id
from conetl.hold h
where upper_inf(h.system_period) and not h.by_map
and not exists (select from conetl.active_decision a where a.changeset_id = h.changeset_id and a.kind = 'accept');
comment on view conetl.discounted is 'Changesets that were reverted, or whose recording is on hold.';

create or replace view conetl.newer_delivery as
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
select
    d.*, c.changeset_id, c.changeset_no, c.idempotency_key,
    row(d.captured_from_ns, d.content_sha256, c.idempotency_key)::conetl.drive_order as drive_order
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
    'The drives that make the map: not reverted, and of each recording the analysis and delivery that was ingested last. drive_order: '
    'the order in which drives are compared with the map.';

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

create or replace view conetl.effect as
select c.changeset_id, coalesce(r.at, c.committed_at) as at
from conetl.changeset c
cross join lateral (  -- once for each changeset
    select min(lower(x.system_period)) as at
    from conetl.delta x
    where x.changeset_id = c.changeset_id and upper_inf(x.system_period)
    and exists (select from conetl.hold h where h.changeset_id = c.changeset_id and lower(h.system_period) = c.committed_at)
) r;
comment on view conetl.effect is
    'When the changes by a changeset were made: at its commit, or of a drive that was committed on hold, when it was released.';

create or replace view conetl.latest_receipt as
select distinct on (map_name, header_sha256) *
from conetl.receipt
order by map_name, header_sha256, receipt_no desc;
comment on view conetl.latest_receipt is 'The last receipt of every drive; started and no lock held: it was interrupted.';

create or replace view conetl.track_member as
select t.drive_uuid, t.track_index, m.frame_index, m.match_index
from conetl.track t
cross join lateral rows from (unnest(t.members[:][1:1]), unnest(t.members[:][2:2])) as m (frame_index, match_index);
comment on view conetl.track_member is 'The positions of each track, a row each.';

create or replace function conetl.newest_write(of_map integer) returns timestamptz
language sql stable
as $$
    select coalesce(greatest(
        (select max(c.committed_at) from conetl.changeset c where c.map_id = m.map_id),
        (select max(d.decided_at) from conetl.decision d where d.map_id = m.map_id),
        (select max(greatest(lower(p.system_period), case when not upper_inf(p.system_period) then upper(p.system_period) end))
         from conetl.plan p where p.map_id = m.map_id),
        (select max(v.decided_at) from conetl.plan_verdict v where v.map_id = m.map_id)
    ), m.created_at)
    from conetl.map m
    where m.map_id = $1
$$;
comment on function conetl.newest_write is 'When a changeset, a decision, a plan or a verdict of a map was last written; without any, its creation.';
