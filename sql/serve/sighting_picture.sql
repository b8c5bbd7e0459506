-- Purpose: the picture file and the box of one side of one stereo match. Parameters: map_name; drive_uuid; frame_index;
-- match_index; side ('left' or 'right').
-- Columns: source_path (folder of the drive), picture_path, rig (JSON), x_px, y_px, w_px, h_px (rectified picture).
select
    d.source_path, d.rig, case b.side when 'left' then f.left_path else f.right_path end as picture_path,
    b.x_px, b.y_px, b.w_px, b.h_px
from conetl.drive d
join conetl.map m using (map_id)
join conetl.stereo_match s using (drive_uuid)
join conetl.frame_pair f using (drive_uuid, frame_index)
join conetl.detection b
    on b.drive_uuid = d.drive_uuid and b.frame_index = f.frame_index and b.side = %(side)s
    and b.detection_index = case b.side when 'left' then s.left_detection_index else s.right_detection_index end
where m.map_name = %(map_name)s and d.drive_uuid = %(drive_uuid)s
and s.frame_index = %(frame_index)s and s.match_index = %(match_index)s;
