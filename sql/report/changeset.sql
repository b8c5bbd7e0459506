-- Purpose: what a report of one changeset needs beyond the list of changesets. Parameters: changeset_id.
-- Columns: source_path, srid, rig (JSON, null for an imported map), expected_frame_count, content_sha256, pruned_at, params,
-- facts (JSON or null), started_at, finished_at (of the merge),
-- steps (JSON list of
-- step, task_count, busy_s, started_s, ended_s; null: not kept).
select
    d.source_path, d.srid, d.rig, d.expected_frame_count, d.content_sha256, d.pruned_at,
    r.params, r.facts, r.started_at, r.finished_at,
    (
        select jsonb_agg(to_jsonb(s) - 'run_id' order by s.started_s, s.step)
        from conetl.run_step s
        where s.run_id = c.run_id
    ) as steps
from conetl.changeset c
join conetl.drive d using (drive_uuid)
left join conetl.run r using (run_id)
where c.changeset_id = %(changeset_id)s;
