-- Purpose: the frame pairs of a drive. Parameters: drive_uuid. Columns: as FramePair and its Pose.
select
    p.frame_index, p.left_path, p.right_path, p.captured_at_ns, ST_X(p.geom), ST_Y(p.geom), ST_Z(p.geom),
    p.map_r_body, p.sigma_enu_m, p.sigma_rpy_rad
from conetl.frame_pair p
where p.drive_uuid = %(drive_uuid)s
order by p.frame_index;
