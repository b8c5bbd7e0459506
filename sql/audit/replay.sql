-- Purpose: playing all deltas in the order of their changesets gives the map as it is, and every delta starts from what the one
-- before it left.
-- Columns: feature_id, problem, expected, found.
with chain as (
    select
        x.feature_id, x.kind, x.old_version, x.new_version, c.changeset_no,
        lag(x.new_version) over w as left_version,
        lag(x.kind) over w as left_kind,
        lead(x.kind) over w is null as is_last
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    window w as (partition by x.feature_id order by c.changeset_no)
),
current as (
    select feature_id, version, present
    from conetl.feature_version
    where upper_inf(system_period) and upper_inf(valid_period)
)
select
    feature_id, 'the delta does not start from what the one before it left' as problem,
    coalesce(left_version::text, 'nothing') as expected, coalesce(old_version::text, 'nothing') as found
from chain
where case
    when kind = 'added' then old_version is not null or coalesce(left_kind, 'removed') <> 'removed'
    else left_version is distinct from old_version or left_kind = 'removed'
end
union all
select
    coalesce(l.feature_id, v.feature_id), 'the map is not what its deltas make',
    coalesce('version ' || l.new_version || case when l.kind = 'removed' then ', gone' else ', standing' end, 'nothing'),
    coalesce('version ' || v.version || case when v.present then ', standing' else ', gone' end, 'nothing')
from (select * from chain where is_last) l
full join current v using (feature_id)
where l.new_version is distinct from v.version or (l.kind <> 'removed') is distinct from v.present;
