-- Purpose: every feature version belongs to a feature and to a changeset of the same map.
-- Columns: feature_id, version, changeset_id, problem.
select
    v.feature_id, v.version, v.changeset_id,
    case
        when f.feature_id is null then 'has no feature'
        when c.changeset_id is null then 'has no changeset'
        when f.cell <> v.cell then 'its cell is not the one of its feature'
        else 'feature, changeset and version are of different maps'
    end as problem
from conetl.feature_version v
left join conetl.feature f on f.feature_id = v.feature_id
left join conetl.changeset c on c.changeset_id = v.changeset_id
where f.feature_id is null or c.changeset_id is null or f.map_id <> c.map_id or v.map_id <> f.map_id or v.cell <> f.cell;
