-- Purpose: the frame pairs in which a feature was seen, with where the camera stood. Parameters: map_name; feature_id; max_rows.
-- Columns: changeset_no, drive_id, drive_uuid, frame_index, match_index, captured_at_ns, easting_m, northing_m, height_m (as this
-- one frame pair places it), cov_xx, cov_xy, cov_yy (m^2), range_m, residual_rms_px, score; body_* place and map_r_body of the
-- body; left_*_px, right_*_px boxes in pixels of the rectified picture.
-- In two steps, because planning one join of ten tables takes a hundred times as long as running it.
with seen as materialized (
    select c.changeset_no, d.drive_id, d.drive_uuid, t.frame_index, t.match_index
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    join conetl.map m using (map_id)
    join conetl.drive d using (drive_uuid)
    join conetl.track_member t on t.drive_uuid = d.drive_uuid and t.track_index = x.track_index
    where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s and m.map_name = %(map_name)s and upper_inf(x.system_period)
    order by c.changeset_no, t.frame_index
    limit %(max_rows)s
)

select
    t.changeset_no, t.drive_id, t.drive_uuid, t.frame_index, t.match_index, f.captured_at_ns,
    ST_X(p.geom) as easting_m, ST_Y(p.geom) as northing_m, ST_Z(p.geom) as height_m,
    p.cov_xx, p.cov_xy, p.cov_yy, p.range_m, p.residual_rms_px, p.score,
    ST_X(f.geom) as body_easting_m, ST_Y(f.geom) as body_northing_m, ST_Z(f.geom) as body_height_m, f.map_r_body,
    l.x_px as left_x_px, l.y_px as left_y_px, l.w_px as left_w_px, l.h_px as left_h_px, l.score as left_score,
    r.x_px as right_x_px, r.y_px as right_y_px, r.w_px as right_w_px, r.h_px as right_h_px, r.score as right_score
from seen t
join conetl.stereo_match s using (drive_uuid, frame_index, match_index)
join conetl.position p using (drive_uuid, frame_index, match_index)
join conetl.frame_pair f using (drive_uuid, frame_index)
join conetl.detection l
    on l.drive_uuid = t.drive_uuid and l.frame_index = t.frame_index
    and l.side = 'left' and l.detection_index = s.left_detection_index
join conetl.detection r
    on r.drive_uuid = t.drive_uuid and r.frame_index = t.frame_index
    and r.side = 'right' and r.detection_index = s.right_detection_index
order by t.changeset_no, f.captured_at_ns, t.frame_index;
