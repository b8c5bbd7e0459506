-- Purpose: playing all deltas that are believed now in the order in which their drives were recorded gives the map as it is, every
-- delta starts from what the one before it left, and only drives that count have such deltas.
-- Columns: feature_id, problem, expected, found.
with chain as (
    select
        x.feature_id, x.kind, x.old_version, x.new_version,
        lag(x.new_version) over w as left_version,
        lag(x.kind) over w as left_kind,
        lead(x.kind) over w is null as is_last
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    join conetl.drive d using (drive_uuid)
    where upper_inf(x.system_period)
    window w as (partition by x.feature_id order by d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C")
),
current as (
    select feature_id, version, present or suppressed as present
    from conetl.feature_version
    where upper_inf(system_period) and upper_inf(valid_period)
)
select
    feature_id, 'the delta does not start from what the one before it left' as problem,
    coalesce(left_version::text, 'nothing') as expected, coalesce(old_version::text, 'nothing') as found
from chain
where case
    when kind in ('added', 'split') then old_version is not null or not coalesce(left_kind in ('removed', 'merged'), true)
    else left_version is distinct from old_version or left_kind in ('removed', 'merged')
end
union all
select
    coalesce(l.feature_id, v.feature_id), 'the map is not what its deltas make',
    coalesce('version ' || l.new_version || case when l.kind in ('removed', 'merged') then ', gone' else ', standing' end, 'nothing'),
    coalesce('version ' || v.version || case when v.present then ', standing' else ', gone' end, 'nothing')
from (select * from chain where is_last) l
full join current v using (feature_id)
where l.new_version is distinct from v.version or (l.kind not in ('removed', 'merged')) is distinct from v.present
union all
select x.feature_id, 'is still changed by a drive that does not count', 'nothing', x.kind
from conetl.delta x
where upper_inf(x.system_period) and exists (select from conetl.changeset c where c.changeset_id = x.changeset_id)
and not exists (select from conetl.active_drive a where a.changeset_id = x.changeset_id);
