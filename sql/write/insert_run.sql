-- Purpose: the run that made a changeset. Parameters: run_id, started_at, finished_at, params (json), flow_run_id, facts (json or null).
insert into conetl.run (run_id, started_at, finished_at, params, flow_run_id, facts)
values (%(run_id)s, %(started_at)s, greatest(%(finished_at)s, %(started_at)s), %(params)s, %(flow_run_id)s, %(facts)s);
