-- Purpose: the poses that an ingested drive was placed by (refined ones where they were refined), of its last analysis.
-- Parameters: map_name; content_sha256. Columns: frame_index, easting_m, northing_m, height_m (of the body), map_r_body (9).
select f.frame_index, ST_X(f.geom) as easting_m, ST_Y(f.geom) as northing_m, ST_Z(f.geom) as height_m, f.map_r_body
from conetl.frame_pair f
where f.drive_uuid = (
    select d.drive_uuid
    from conetl.drive d
    join conetl.map m using (map_id)
    join conetl.changeset c using (drive_uuid)
    where m.map_name = %(map_name)s and d.content_sha256 = %(content_sha256)s
    order by c.changeset_no desc
    limit 1
)
order by f.frame_index;
