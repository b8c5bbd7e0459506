-- What people decided about a map. Append-only.

-- name: active_decisions
-- The decisions about a map that were not withdrawn, and the drives on hold (kind 'hold'), oldest first.
-- Parameters: map_name.
-- Columns: position and radius are null of a changeset, classes of all but kind 'classify', drive_id is that of a changeset;
-- decided_by is null of a hold and where no name was kept.
select
    d.decision_id, d.kind, d.easting_m, d.northing_m, d.radius_m, d.of_line, d.category, d.found_as, d.feature_id,
    d.changeset_id, d.approves, r.drive_id, d.note, d.decided_by, d.decided_at
from (
    select
        a.decision_id, a.map_id, a.kind, ST_X(a.geom) as easting_m, ST_Y(a.geom) as northing_m, a.radius_m, a.of_line, a.category,
        a.found_as, a.feature_id, a.changeset_id, a.approves, a.note, a.decided_by, a.decided_at
    from conetl.active_decision a
    union all
    select h.hold_id, h.map_id, 'hold', null, null, null, false, null, null, null, h.changeset_id, null, h.reason, null, h.since
    from conetl.on_hold h
) d
join conetl.map m using (map_id)
left join conetl.changeset c on c.changeset_id = d.changeset_id
left join conetl.drive r on r.drive_uuid = c.drive_uuid
where m.map_name = %(map_name)s
order by d.decided_at, d.decision_id;

-- name: find_decisions
-- The changeset with a number, or decisions and changesets whose id begins with a text; at most two.
-- Parameters: map_name; beginning (lower case). The number of a changeset of this map always means that changeset,
-- even if ids begin with it. Digits alone are the beginning of an id from eight characters on, as lists show ids;
-- fewer are a number, possibly of another map. Other texts need at least four characters.
-- Columns: id, kind ('changeset', or the decision's), drive_uuid, active (a decision that was not withdrawn),
-- changeset_id.
with named as (
    select d.decision_id as id, d.kind, c.drive_uuid, d.changeset_id,
        exists (select from conetl.active_decision a where a.decision_id = d.decision_id) as active,
        false as is_number
    from conetl.decision d
    join conetl.map m using (map_id)
    left join conetl.changeset c on c.changeset_id = d.changeset_id
    where m.map_name = %(map_name)s
    union all
    select c.changeset_id, 'changeset', c.drive_uuid, c.changeset_id, true, c.changeset_no::text = %(beginning)s
    from conetl.changeset c
    join conetl.map m using (map_id)
    where m.map_name = %(map_name)s
)
select n.id, n.kind, n.drive_uuid, n.changeset_id, n.active
from named n
where n.is_number
or (
    starts_with(n.id::text, %(beginning)s)
    and length(%(beginning)s) >= case when %(beginning)s ~ '^[0-9]+$' then 8 else 4 end
    and not exists (select from named x where x.is_number)
)
order by n.id
limit 2;

-- name: insert_decision
-- What a person decided. Parameters: as the columns; easting_m, northing_m (null of a revert or withdrawal).
insert into conetl.decision (
    decision_id, map_id, srid, kind, geom, radius_m, of_line, category, found_as, feature_id, changeset_id, withdraws,
    approves, note, decided_by, decided_at
) values (
    %(decision_id)s, %(map_id)s, %(srid)s, %(kind)s,
    ST_SetSRID(ST_MakePoint(%(easting_m)s::float8, %(northing_m)s::float8), %(srid)s), %(radius_m)s, %(of_line)s,
    %(category)s, %(found_as)s, %(feature_id)s, %(changeset_id)s, %(withdraws)s, %(approves)s, %(note)s, %(decided_by)s,
    %(decided_at)s
);
