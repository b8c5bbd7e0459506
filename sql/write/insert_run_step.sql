-- Purpose: how long one step of the run of a changeset took. Parameters: changeset_id, step, task_count, busy_s (summed over its tasks),
-- started_s, ended_s (since the run's first step began).
insert into conetl.run_step (run_id, step, task_count, busy_s, started_s, ended_s)
select c.run_id, %(step)s, %(task_count)s, %(busy_s)s, %(started_s)s, %(ended_s)s
from conetl.changeset c
where c.changeset_id = %(changeset_id)s and c.run_id is not null
on conflict (run_id, step) do nothing;
