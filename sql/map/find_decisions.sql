-- Purpose: the changeset of a number, or decisions and changesets with an id that begins so; at most two. Parameters: map_name, beginning
-- (lower case). A number of a changeset of this map is meant as one, whatever ids begin so. Digits alone are the beginning of an id from
-- eight characters on, as lists show ids: fewer are a number, and where this map has none of it, that of another map. Other text is
-- one from four characters on.
-- Columns: id, kind ('changeset', or the decision's), drive_uuid, active (a decision that was not taken back), changeset_id.
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
