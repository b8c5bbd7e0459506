-- Purpose: what of a place's covariance other drives with the same calibration have in common with it, so that the error of a rig's
-- calibration is not averaged away over its drives.
--
-- Both columns are null where nothing of it is known: of drives and versions from before, of rigs without a stated covariance, of imported
-- maps. Such places are fused as before. Nothing is written anew.

alter table conetl.track add column calibrations uuid[], add column shared_jacobian_m real[];
comment on column conetl.track.calibrations is
    'Whose error is in the covariance: the calibration as the drive was given it, before any self-calibration; null: not known.';
comment on column conetl.track.shared_jacobian_m is
    'shared_jacobian_m[c][axis][k]: metres by which one sigma of error k of calibration c moves the place to the east, north and up (1, 2, 3).';

alter table conetl.feature_version add column calibrations uuid[], add column shared_jacobian_m real[];
comment on column conetl.feature_version.calibrations is
    'Calibrations whose error is in the covariance, by the drives that the place is from, in rising order; null: none that is known.';
comment on column conetl.feature_version.shared_jacobian_m is
    'shared_jacobian_m[c][axis][k]: metres by which one sigma of error k of calibration c moves the place to the east, north and up (1, 2, 3).';

-- As it was; v.* has the two columns at its end now, and map_as_of returns what this view has.
create or replace view conetl.current_feature as
select m.map_name, v.*
from conetl.feature_version v
join conetl.map m using (map_id)
where upper_inf(v.system_period) and upper_inf(v.valid_period) and v.present;
