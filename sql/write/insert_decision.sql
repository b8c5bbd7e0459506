-- Purpose: what a person decided. Parameters: decision_id, map_id, srid, kind, easting_m, northing_m, radius_m (null but for places),
-- feature_id, changeset_id, withdraws, note, decided_by, decided_at.
insert into conetl.decision (
    decision_id, map_id, srid, kind, geom, radius_m, feature_id, changeset_id, withdraws, note, decided_by, decided_at
) values (
    %(decision_id)s, %(map_id)s, %(srid)s, %(kind)s,
    ST_SetSRID(ST_MakePoint(%(easting_m)s::float8, %(northing_m)s::float8), %(srid)s), %(radius_m)s,
    %(feature_id)s, %(changeset_id)s, %(withdraws)s, %(note)s, %(decided_by)s, %(decided_at)s
);
