-- Purpose: exactly one version of every feature that is believed in is open now, and every feature was believed in once.
-- Columns: feature_id, open_count, problem.
select f.feature_id, count(v.*) filter (where upper_inf(v.system_period) and upper_inf(v.valid_period)) as open_count,
    case when count(v.*) = 0 then 'has no version' else 'should have one open version' end as problem
from conetl.feature f
left join conetl.feature_version v using (feature_id)
group by f.feature_id
having count(v.*) = 0
or count(v.*) filter (where upper_inf(v.system_period)) > 0
    and count(v.*) filter (where upper_inf(v.system_period) and upper_inf(v.valid_period)) <> 1;
