-- QGIS, GDAL and other programs list the tables of a database by PostGIS's view geometry_columns, which takes what follows the first
-- " = " of a constraint with "srid(...) = " for a number: with "ST_SRID(geom) = srid" every query of the view failed. It does not read
-- constraints that begin with the other side.

alter table conetl.feature_version
    drop constraint feature_version_check,
    drop constraint line_has_all_columns,
    add constraint srid_of_geom check (srid = ST_SRID(geom)),
    add constraint srid_of_centre_geom check (srid = ST_SRID(centre_geom)),
    add constraint line_has_all_columns check (
        num_nulls(line, line_cov, width_m, width_sigma_m, colour, pattern) in (0, 6)
        and (dash_m is null) = (gap_m is null)
        and (line is null or srid = ST_SRID(line))
    );
alter table conetl.decision
    drop constraint decision_check1,
    add constraint srid_of_geom check (geom is null or srid = ST_SRID(geom));
alter table conetl.base_source
    drop constraint base_source_check,
    add constraint srid_of_extent check (srid = ST_SRID(extent));
alter table conetl.provisional_feature
    drop constraint provisional_feature_check1,
    add constraint srid_of_geom check (srid = ST_SRID(geom));
