-- Purpose: decisions and changesets with an id that begins so (four characters and more: less is a changeset's number), or the
-- changeset of that number; at most two. Parameters: map_name, beginning (lower case).
-- Columns: id, kind ('changeset', or the decision's), drive_uuid, active (a decision that was not taken back), changeset_id.
select d.decision_id as id, d.kind, c.drive_uuid, d.changeset_id,
    exists (select from conetl.active_decision a where a.decision_id = d.decision_id) as active
from conetl.decision d
join conetl.map m using (map_id)
left join conetl.changeset c on c.changeset_id = d.changeset_id
where m.map_name = %(map_name)s and starts_with(d.decision_id::text, %(beginning)s) and length(%(beginning)s) >= 4
union all
select c.changeset_id, 'changeset', c.drive_uuid, c.changeset_id, true
from conetl.changeset c
join conetl.map m using (map_id)
where m.map_name = %(map_name)s
and (starts_with(c.changeset_id::text, %(beginning)s) and length(%(beginning)s) >= 4 or c.changeset_no::text = %(beginning)s)
order by 1
limit 2;
