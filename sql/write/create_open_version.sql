-- Purpose: the version that is believed and open now of each staged feature that stands around the drive, found by place, where they lie
-- together. For the others see add_open_versions.sql. around is materialized: joined with the stage at once, the planner reads all of a
-- map of ten million features.
-- Parameters: drive_uuid.
-- Columns: feature_id, cell, map_id, version_row_id, version, present (or suppressed), valid_from (timestamptz), valid_from_ns.
create temporary table open_version on commit drop as
with around as materialized (
    select distinct on (v.feature_id)
        v.feature_id, v.cell, v.map_id, v.version_row_id, v.version, v.present or v.suppressed as present,
        lower(v.valid_period) as valid_from, v.valid_from_ns
    from conetl.drive d
    cross join lateral conetl.pieces(d.area) piece
    join conetl.feature_version v on v.map_id = d.map_id and v.geom && piece
    where d.drive_uuid = %(drive_uuid)s and upper_inf(v.system_period) and upper_inf(v.valid_period)
    order by v.feature_id
)
select a.*
from around a
join delta_stage s using (feature_id);
