-- Purpose: the pair of pictures that shows a cone best: the nearest position of a track. Parameters: drive_uuid, track_index.
-- Columns: frame_index, range_m, source_path, rig (JSON), left_path, right_path, left_* and right_* boxes in pixels of the rectified picture.
select
    p.frame_index, p.range_m, d.source_path, d.rig, f.left_path, f.right_path,
    l.x_px as left_x_px, l.y_px as left_y_px, l.w_px as left_w_px, l.h_px as left_h_px,
    r.x_px as right_x_px, r.y_px as right_y_px, r.w_px as right_w_px, r.h_px as right_h_px
from conetl.track_member t
join conetl.drive d using (drive_uuid)
join conetl.position p using (drive_uuid, frame_index, match_index)
join conetl.stereo_match s using (drive_uuid, frame_index, match_index)
join conetl.frame_pair f using (drive_uuid, frame_index)
join conetl.detection l
    on l.drive_uuid = t.drive_uuid and l.frame_index = t.frame_index
    and l.side = 'left' and l.detection_index = s.left_detection_index
join conetl.detection r
    on r.drive_uuid = t.drive_uuid and r.frame_index = t.frame_index
    and r.side = 'right' and r.detection_index = s.right_detection_index
where t.drive_uuid = %(drive_uuid)s and t.track_index = %(track_index)s
order by p.range_m, p.frame_index
limit 1;
