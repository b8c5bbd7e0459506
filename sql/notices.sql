-- Notices of work zones and differences from plans, and who has been notified.

-- name: last_notices
-- The last notice of every subject of a map. Parameters: map_id. Columns: topic, subject_id, event, state.
select distinct on (n.topic, n.subject_id) n.topic, n.subject_id::text as subject_id, n.event, n.state
from conetl.notice n
where n.map_id = %(map_id)s
order by n.topic, n.subject_id, n.notice_no desc;

-- name: round_due
-- Whether anything changed since the notices of a map were recorded, or, where it has plans, so much time has passed that one of them
-- may be due. Parameters: map_id; most_s.
-- Columns: newest (see conetl.newest_write), has_plans, feature_count (standing now), is_due.
select
    newest.at as newest, plans.has_plans,
    (
        select coalesce(sum(c.feature_count), 0)::integer from conetl.feature_cell c where c.map_id = m.map_id and c.zoom = 4
    ) as feature_count,
    r.map_id is null or newest.at > r.seen_at
    or (plans.has_plans and r.checked_at < now() - %(most_s)s * interval '1 second') as is_due
from conetl.map m
left join conetl.notice_round r using (map_id)
cross join lateral (
    select exists (select from conetl.plan p where p.map_id = m.map_id and upper_inf(p.system_period)) as has_plans
) plans
cross join lateral (select conetl.newest_write(m.map_id) as at) newest
where m.map_id = %(map_id)s;

-- name: zone_aliases
-- Ids that work zones keep. Parameters: map_name. Columns: computed_id, zone_id.
select a.computed_id, a.zone_id
from conetl.zone_alias a
join conetl.map m using (map_id)
where m.map_name = %(map_name)s;

-- name: zone_versions
-- The stored versions of work zones, by zone, as the database knew them. Parameters: map_name; beginning (of the id); known_at
-- (timestamptz, 'infinity': now). Columns: zone_id, version, event, recorded_at, state.
select
    n.subject_id::text as zone_id, row_number() over (partition by n.subject_id order by n.notice_no) as version, n.event,
    n.recorded_at, n.state
from conetl.notice n
join conetl.map m using (map_id)
where m.map_name = %(map_name)s and n.topic = 'work_zone' and n.recorded_at <= %(known_at)s::timestamptz
and n.subject_id::text like %(beginning)s || '%%'
order by min(n.notice_no) over (partition by n.subject_id), n.notice_no;

-- name: write_round
-- Parameters: map_id; newest.
insert into conetl.notice_round (map_id, seen_at, checked_at) values (%(map_id)s, %(newest)s, now())
on conflict (map_id) do update set seen_at = excluded.seen_at, checked_at = excluded.checked_at;

-- name: add_receiver
-- A receiver that is new gets what is recorded from now on, and what still holds. Parameters: receiver; map_id.
insert into conetl.notice_receiver (receiver, map_id, after_no)
select %(receiver)s, %(map_id)s, coalesce(max(n.notice_no), 0) from conetl.notice n where n.map_id = %(map_id)s
on conflict do nothing;

-- name: due_notices
-- The next notice of every subject, if it is due, oldest first: a later one of a subject waits for those before it.
-- Parameters: receiver; map_id; most. Columns: notice_no, topic, subject_id, event, state, recorded_at, attempts, first_at.
select * from (
    select distinct on (n.topic, n.subject_id)
        n.notice_no, n.topic, n.subject_id::text as subject_id, n.event, n.state, n.recorded_at,
        coalesce(d.attempts, 0) as attempts, d.first_at, d.next_at
    from conetl.notice n
    join conetl.notice_receiver r on r.map_id = n.map_id and r.receiver = %(receiver)s
    left join conetl.notice_delivery d on d.notice_no = n.notice_no and d.receiver = r.receiver
    where n.map_id = %(map_id)s and d.delivered_at is null and d.given_up_at is null
    and (
        n.notice_no > r.after_no
        or (
            n.event in ('began', 'changed')
            and not exists (
                select from conetl.notice later
                where later.map_id = n.map_id and later.topic = n.topic and later.subject_id = n.subject_id
                and later.notice_no > n.notice_no
            )
        )
    )
    order by n.topic, n.subject_id, n.notice_no
) as first
where first.next_at is null or first.next_at <= now()
order by first.notice_no
limit %(most)s;

-- name: write_delivery
-- How an attempt ended. Parameters: receiver; notice_no; delivered (boolean); problem (null: none); wait_s (until the next attempt);
-- patience_s (an attempt that fails so long after the first one is the last).
insert into conetl.notice_delivery as d (receiver, notice_no, attempts, first_at, next_at, delivered_at, problem)
values (
    %(receiver)s, %(notice_no)s, 1, now(), case when not %(delivered)s then now() + %(wait_s)s * interval '1 second' end,
    case when %(delivered)s then now() end, %(problem)s
)
on conflict (receiver, notice_no) do update set
    attempts = d.attempts + 1, problem = excluded.problem, delivered_at = excluded.delivered_at,
    given_up_at = case
        when not %(delivered)s and now() > d.first_at + %(patience_s)s * interval '1 second' then now()
    end,
    next_at = case
        when not %(delivered)s and now() <= d.first_at + %(patience_s)s * interval '1 second' then excluded.next_at
    end;

-- name: try_again
-- Notices that were given up become due. Parameters: map_id. Columns: notice_no.
update conetl.notice_delivery d set given_up_at = null, first_at = now(), next_at = now()
from conetl.notice n
where n.notice_no = d.notice_no and n.map_id = %(map_id)s and d.given_up_at is not null
returning d.notice_no;

-- name: undelivered
-- Notices that could not be delivered, oldest first. Parameters: map_name (null: all
-- maps). Columns: map_name, receiver, notice_no, topic, subject_id, event, recorded_at, attempts, problem, next_at, given_up_at.
select
    m.map_name, d.receiver, n.notice_no, n.topic, n.subject_id::text as subject_id, n.event, n.recorded_at, d.attempts, d.problem,
    d.next_at, d.given_up_at
from conetl.notice_delivery d
join conetl.notice n using (notice_no)
join conetl.map m using (map_id)
where d.delivered_at is null and (%(map_name)s::text is null or m.map_name = %(map_name)s)
order by n.notice_no, d.receiver;
