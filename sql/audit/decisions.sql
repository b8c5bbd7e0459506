-- Purpose: every decision is about what its own map knows: a feature and a changeset of that map, an earlier decision of it, and no
-- changeset is reverted twice at once.
-- Columns: decision_id, kind, problem.
select d.decision_id, d.kind, p.problem
from conetl.decision d
left join conetl.feature f on f.feature_id = d.feature_id
left join conetl.changeset c on c.changeset_id = d.changeset_id
left join conetl.decision w on w.decision_id = d.withdraws
cross join lateral (
    select case
        when d.feature_id is not null and f.feature_id is null then 'its feature was never known'
        when f.map_id <> d.map_id then 'its feature is of another map'
        when d.changeset_id is not null and c.changeset_id is null then 'its changeset does not exist'
        when c.map_id <> d.map_id then 'its changeset is of another map'
        when d.withdraws is not null and w.decision_id is null then 'it withdraws a decision that does not exist'
        when w.map_id <> d.map_id then 'it withdraws a decision of another map'
        when w.kind = 'withdraw' then 'it withdraws a withdrawal'
        when w.decided_at >= d.decided_at then 'it withdraws a decision that was not made before it'
        when c.committed_at >= d.decided_at then 'it reverts a changeset that was not committed before it'
        when d.kind = 'revert' and exists (select from conetl.active_decision a where a.decision_id = d.decision_id) and exists (
            select from conetl.active_decision a
            where a.kind = 'revert' and a.changeset_id = d.changeset_id and a.decision_id <> d.decision_id
        ) then 'another decision reverts the same changeset'
    end as problem
) p
where p.problem is not null;
