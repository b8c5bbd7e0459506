-- Drives on hold: what begins and ends a hold, which drives wait, and what happened in order.

-- name: end_holds
-- End the holds by the map of some changesets that are no longer held for this reason. A hold because of the recording
-- itself remains, even if it was accepted.
-- Parameters: committed_at (timestamptz); changeset_ids (uuid[]); reasons (text[], null: not held).
update conetl.hold h
set system_period = tstzrange(lower(h.system_period), %(committed_at)s)
from unnest(%(changeset_ids)s::uuid[], %(reasons)s::text[]) n (changeset_id, reason)
where h.changeset_id = n.changeset_id and h.by_map and upper_inf(h.system_period) and h.reason is distinct from n.reason;

-- name: begin_holds
-- Put some changesets on hold, unless they are on hold already.
-- Parameters: committed_at; changeset_ids; reasons (as for end_holds); checks (text[], JSON arrays of health checks); by_map:
-- whether the comparison with the map decided it.
insert into conetl.hold (changeset_id, by_map, reason, checks, system_period)
select n.changeset_id, %(by_map)s, n.reason, n.checks::jsonb, tstzrange(%(committed_at)s, null)
from unnest(%(changeset_ids)s::uuid[], %(reasons)s::text[], %(checks)s::text[]) n (changeset_id, reason, checks)
where n.reason is not null
on conflict (changeset_id) where upper_inf(system_period) do nothing;

-- name: held_drives
-- The drives of a map that are on hold now, the oldest hold first. A hold whose cause or figures changed continues.
-- Parameters: map_name. Columns: as HeldDrive.
with recursive waiting as (
    select h.changeset_id, h.since
    from conetl.on_hold h
    union all
    select p.changeset_id, lower(p.system_period)
    from waiting w
    join conetl.hold p on p.changeset_id = w.changeset_id and upper(p.system_period) = w.since
)
select d.drive_id, c.changeset_no, h.changeset_id, w.since, h.checks
from conetl.on_hold h
join (select changeset_id, min(since) as since from waiting group by changeset_id) w using (changeset_id)
join conetl.map m using (map_id)
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid)
where m.map_name = %(map_name)s
order by w.since, c.changeset_no;

-- name: unheld_states
-- Why changesets are no longer on hold. Parameters: changeset_ids (uuid[]).
-- Columns: changeset_id; state: reverted, released (it counts) or replaced (by a later delivery of the recording).
select
    c.changeset_id,
    case
        when exists (select from conetl.active_decision a where a.changeset_id = c.changeset_id and a.kind = 'revert') then 'reverted'
        when exists (select from conetl.active_drive a where a.changeset_id = c.changeset_id) then 'released'
        else 'replaced'
    end as state
from conetl.changeset c
where c.changeset_id = any(%(changeset_ids)s);

-- name: replaced_by
-- The later delivery of a changeset's recording that counts, or waits, in its place; no row if the changeset itself was
-- reverted, or counts because the later one does not. Parameters: changeset_id. Columns: changeset_no.
select n.newer_no as changeset_no
from conetl.newer_delivery n
where n.changeset_id = %(changeset_id)s
and not exists (
    select from conetl.active_decision a where a.changeset_id in (n.changeset_id, n.newer_id) and a.kind = 'revert'
)
and (
    exists (select from conetl.discounted r where r.changeset_id = n.changeset_id)
    or not exists (select from conetl.discounted r where r.changeset_id = n.newer_id)
)
order by n.newer_no desc
limit 1;

-- name: earlier_deliveries
-- The earlier analyses and deliveries of the recording of a changeset. Parameters: changeset_id. Columns: changeset_id.
select n.changeset_id from conetl.newer_delivery n where n.newer_id = %(changeset_id)s;

-- name: map_checks
-- The open hold of a changeset by the map, whether the drive is active or not. Parameters: changeset_id. Columns: checks.
select h.checks
from conetl.hold h
where h.changeset_id = %(changeset_id)s and h.by_map and upper_inf(h.system_period);

-- name: hold_events
-- What happened to drives that are or were on hold, in order. The end of a hold by acceptance, or by a hold with
-- another cause, is not a separate event; nor is a hold with other figures of the same check.
-- Parameters: map_name; since, until (timestamptz, null: all). Columns: as HoldEvent.
with held as (
    select distinct h.changeset_id, c.changeset_no, d.drive_id
    from conetl.hold h
    join conetl.changeset c using (changeset_id)
    join conetl.drive d using (drive_uuid)
    join conetl.map m on m.map_id = c.map_id
    where m.map_name = %(map_name)s
),
event as (
    select h.changeset_id, lower(h.system_period) as at, 3 as rank, 'on hold' as what, '' as detail, null::text as by, h.checks
    from conetl.hold h
    where not exists (
        select from conetl.hold p
        where p.changeset_id = h.changeset_id and upper(p.system_period) = lower(h.system_period)
        and jsonb_path_query_array(p.checks, '$[*].name') = jsonb_path_query_array(h.checks, '$[*].name')
    )
    union all
    select h.changeset_id, upper(h.system_period), 3, 'released', 'Nothing contradicts it any more.', null, '[]'
    from conetl.hold h
    where not upper_inf(h.system_period)
    and not exists (
        select from conetl.hold n where n.changeset_id = h.changeset_id and lower(n.system_period) = upper(h.system_period)
    )
    and not exists (
        select from conetl.decision a
        where a.changeset_id = h.changeset_id and a.kind = 'accept' and a.decided_at = upper(h.system_period)
    )
    union all
    select
        d.changeset_id, d.decided_at, 1, case d.kind when 'accept' then 'accepted' else 'reverted' end, d.note, d.decided_by, '[]'
    from conetl.decision d
    where d.kind in ('accept', 'revert')
    union all
    select
        d.changeset_id, w.decided_at, 2, case d.kind when 'accept' then 'acceptance withdrawn' else 'revert withdrawn' end, w.note,
        w.decided_by, '[]'
    from conetl.decision w
    join conetl.decision d on d.decision_id = w.withdraws
    where d.kind in ('accept', 'revert')
    union all
    select n.changeset_id, c.committed_at, 0, 'delivered again', 'Changeset ' || n.newer_no || '.', null, '[]'
    from conetl.newer_delivery n
    join conetl.changeset c on c.changeset_id = n.newer_id
)
select e.at, h.drive_id, h.changeset_no, e.changeset_id, e.what, e.detail, e.by, e.checks
from held h
join event e using (changeset_id)
where (%(since)s::timestamptz is null or e.at >= %(since)s) and (%(until)s::timestamptz is null or e.at < %(until)s)
order by e.at, e.rank, h.changeset_no;
