-- Purpose: every raw record belongs to its drive, frame pair, stereo match, position and track (of a pruned drive the
-- positions are gone), and every drive to a changeset.
-- Columns: table_name, drive_uuid, row_count, problem.
select 'drive' as table_name, d.drive_uuid, count(*) as row_count, 'has no changeset' as problem
from conetl.drive d
where not exists (select from conetl.changeset c where c.drive_uuid = d.drive_uuid)
group by d.drive_uuid
union all
select 'frame_pair', p.drive_uuid, count(*), 'has no drive'
from conetl.frame_pair p
where not exists (select from conetl.drive d where d.drive_uuid = p.drive_uuid)
group by p.drive_uuid
union all
select 'detection', x.drive_uuid, count(*), 'has no frame pair'
from conetl.detection x
where not exists (
    select from conetl.frame_pair p where p.drive_uuid = x.drive_uuid and p.frame_index = x.frame_index
)
group by x.drive_uuid
union all
select 'stereo_match', s.drive_uuid, count(*), 'has no left or no right detection'
from conetl.stereo_match s
where not exists (
    select from conetl.detection l
    where l.drive_uuid = s.drive_uuid and l.frame_index = s.frame_index
    and l.side = 'left' and l.detection_index = s.left_detection_index
) or not exists (
    select from conetl.detection r
    where r.drive_uuid = s.drive_uuid and r.frame_index = s.frame_index
    and r.side = 'right' and r.detection_index = s.right_detection_index
)
group by s.drive_uuid
union all
select 'position', x.drive_uuid, count(*), 'has no frame pair'
from conetl.position x
where not exists (
    select from conetl.frame_pair p where p.drive_uuid = x.drive_uuid and p.frame_index = x.frame_index
)
group by x.drive_uuid
union all
select 'track_member', t.drive_uuid, count(*), 'has no track or no position'
from conetl.track_member t
where not exists (
    select from conetl.position p
    where p.drive_uuid = t.drive_uuid and p.frame_index = t.frame_index and p.match_index = t.match_index
) and not exists (
    select from conetl.drive d where d.drive_uuid = t.drive_uuid and d.pruned_at is not null
) or not exists (
    select from conetl.track k where k.drive_uuid = t.drive_uuid and k.track_index = t.track_index
)
group by t.drive_uuid;
