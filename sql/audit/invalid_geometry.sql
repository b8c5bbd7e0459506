-- Purpose: every point is finite, three-dimensional and in the CRS of its map.
-- Columns: table_name, record, geometry, problem.
with point as (
    select
        'feature_version' as table_name, v.feature_id || ' version ' || v.version as record, m.srid, g.geom
    from conetl.feature_version v
    join conetl.map m using (map_id)
    cross join lateral (values (v.geom), (v.centre_geom)) g (geom)
    union all
    select 'position', p.drive_uuid || ' frame ' || p.frame_index || ' match ' || p.match_index, d.srid, g.geom
    from conetl.position p
    join conetl.drive d using (drive_uuid)
    cross join lateral (values (p.geom), (p.centre_geom)) g (geom)
    union all
    select 'track', t.drive_uuid || ' track ' || t.track_index, d.srid, g.geom
    from conetl.track t
    join conetl.drive d using (drive_uuid)
    cross join lateral (values (t.geom), (t.centre_geom)) g (geom)
    union all
    select 'frame_pair', f.drive_uuid || ' frame ' || f.frame_index, d.srid, f.geom
    from conetl.frame_pair f
    join conetl.drive d using (drive_uuid)
)
select table_name, record, ST_AsEWKT(geom) as geometry,
    case when ST_SRID(geom) <> srid then 'should have SRID ' || srid else 'is not a finite point' end as problem
from point
where ST_SRID(geom) <> srid
or ST_IsEmpty(geom)
or not (ST_X(geom) between -1e9 and 1e9 and ST_Y(geom) between -1e9 and 1e9 and ST_Z(geom) between -1e6 and 1e6);
