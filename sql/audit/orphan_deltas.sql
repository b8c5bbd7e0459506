-- Purpose: every delta belongs to a changeset and a feature of the same map, and the versions and the track that it names exist.
-- Columns: changeset_id, feature_id, kind, problem.
select x.changeset_id, x.feature_id, x.kind, p.problem
from conetl.delta x
left join conetl.changeset c on c.changeset_id = x.changeset_id
left join conetl.feature f on f.feature_id = x.feature_id
cross join lateral (
    select case
        when c.changeset_id is null then 'has no changeset'
        when f.feature_id is null then 'has no feature'
        when f.cell <> x.cell then 'its cell is not the one of its feature'
        when f.map_id <> c.map_id then 'its feature and its changeset are of different maps'
        when not exists (
            select from conetl.feature_version v where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version
            and (v.system_period && x.system_period)
        ) then 'its new version does not exist'
        when x.old_version is not null and not exists (
            select from conetl.feature_version v where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.old_version
            and (v.system_period && x.system_period)
        ) then 'its old version does not exist'
        when x.track_index is not null and not exists (
            select from conetl.track t where t.drive_uuid = c.drive_uuid and t.track_index = x.track_index
        ) then 'its track does not exist'
    end as problem
) p
where p.problem is not null;
