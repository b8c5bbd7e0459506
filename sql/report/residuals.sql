-- Purpose: how well the rays of a drive's positions meet. Parameters: drive_uuid. Columns: frame_index, range_m, residual_rms_px.
select frame_index, range_m, residual_rms_px
from conetl.position
where drive_uuid = %(drive_uuid)s
order by frame_index, match_index;
