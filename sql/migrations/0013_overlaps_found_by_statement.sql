-- No two current versions of a feature are valid at the same time: checked once per statement, through feature_version_current. The
-- constraint that checked each row needed a GiST index of its own, two fifths of the bytes of all indexes of feature_version, and
-- took 0.25 s more in a merge of 20,000 versions.
--
-- A lock per map, until the end of the transaction, makes whoever else writes versions of the map wait: each then sees the rows of the
-- other (read committed). Transactions of conetl are one after the other there anyway. Sequential scans are off, because the plan is kept
-- for the session, in which the table may grow from nothing.

create function conetl.refuse_overlaps() returns trigger
language plpgsql
set enable_seqscan = off
as $$
declare
    twice uuid;
begin
    perform pg_advisory_xact_lock(hashtextextended('conetl.versions/' || m.map_id, 0))
    from (select distinct w.map_id from written w order by 1) m;
    select w.feature_id into twice
    from written w
    cross join lateral (
        select v.version_row_id, v.valid_period
        from conetl.feature_version v
        where v.cell = w.cell and v.feature_id = w.feature_id and coalesce(upper(v.system_period), 'infinity') = 'infinity'
        offset 0
    ) v
    where upper_inf(w.system_period) and v.valid_period && w.valid_period and v.version_row_id <> w.version_row_id
    limit 1;
    if found then
        raise exclusion_violation using
            message = format('two current versions of feature %s are valid at the same time (no_overlap)', twice),
            constraint = 'no_overlap';
    end if;
    return null;
end
$$;
comment on function conetl.refuse_overlaps is 'Trigger: no two current versions of a feature are valid at the same time.';

create trigger no_overlap after insert on conetl.feature_version
referencing new table as written for each statement execute function conetl.refuse_overlaps();
create trigger no_overlap_of_changed after update on conetl.feature_version
referencing new table as written for each statement execute function conetl.refuse_overlaps();

alter table conetl.feature_version drop constraint no_overlap;
drop function conetl.version_box;
drop function conetl.microseconds;
drop function conetl.feature_number;
