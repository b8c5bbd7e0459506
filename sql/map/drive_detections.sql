-- Purpose: the detections of a drive. Parameters: drive_uuid. Columns: as Detection (pixels of the original image).
select d.frame_index, d.side, d.detection_index, d.category, d.x_px, d.y_px, d.w_px, d.h_px, d.score
from conetl.detection d
where d.drive_uuid = %(drive_uuid)s
order by d.frame_index, d.side, d.detection_index;
