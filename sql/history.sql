-- What changesets did to features.

-- name: changesets
-- Changesets of a map, newest first, or the one of an idempotency key.
-- Parameters: map_name; idempotency_key (null: all). Columns: as CommittedChangeset.
-- A drive that was committed on hold changed the map when it was released: its counts and effective_at are from then.
select
    c.changeset_no, c.changeset_id, d.drive_id, d.kind, c.drive_uuid, c.idempotency_key, c.params_sha256, c.model_sha256,
    c.code_version, c.committed_at, coalesce(e.at, c.committed_at) as effective_at,
    (c.added_count + e.added)::integer as added_count,
    (c.confirmed_count + e.confirmed)::integer as confirmed_count,
    (c.moved_count + e.moved)::integer as moved_count,
    (c.removed_count + e.removed)::integer as removed_count,
    (c.missed_count + e.missed)::integer as missed_count,
    (c.height_changed_count + e.height_changed)::integer as height_changed_count,
    (c.split_count + e.split)::integer as split_count,
    (c.merged_count + e.merged)::integer as merged_count,
    case when e.at is null then c.line_counts else coalesce((
        select jsonb_object_agg(k.kind, k.count)
        from (
            select x.kind, count(*) as count from conetl.delta x
            where x.changeset_id = c.changeset_id and x.of_line and upper_inf(x.system_period)
            group by x.kind
        ) k
    ), '{}') end as line_counts,
    c.frame_pair_count, c.detection_count, c.match_count, c.position_count, c.track_count, c.marking_count, c.rejection_count,
    d.captured_from_ns, d.captured_to_ns, d.content_sha256, d.expected_frame_count, m.srid as map_srid,
    h.reason is null and exists (select from conetl.active_drive a where a.changeset_id = c.changeset_id) as counts,
    h.reason as hold
from conetl.changeset c
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid)
left join conetl.on_hold h on h.changeset_id = c.changeset_id
cross join lateral (
    select
        min(lower(x.system_period)) as at,
        count(*) filter (where x.kind = 'added' and not x.of_line) as added,
        count(*) filter (where x.kind = 'confirmed' and not x.of_line) as confirmed,
        count(*) filter (where x.kind = 'moved' and not x.of_line) as moved,
        count(*) filter (where x.kind = 'removed' and not x.of_line) as removed,
        count(*) filter (where x.kind = 'missed' and not x.of_line) as missed,
        count(*) filter (where x.kind = 'height_changed' and not x.of_line) as height_changed,
        count(*) filter (where x.kind = 'split' and not x.of_line) as split,
        count(*) filter (where x.kind = 'merged' and not x.of_line) as merged
    from conetl.delta x
    where x.changeset_id = c.changeset_id and upper_inf(x.system_period)
    and exists (select from conetl.hold k where k.changeset_id = c.changeset_id and lower(k.system_period) = c.committed_at)
) e
where m.map_name = %(map_name)s and (%(idempotency_key)s::text is null or c.idempotency_key = %(idempotency_key)s)
order by c.changeset_no desc;

-- name: changes_of_changeset
-- What one changeset did to each feature that it judged, as committed (or as released, if it was committed on hold). An
-- earlier drive that arrived later may have replaced it since: see feature_log. Parameters: map_name; changeset_no.
-- Columns: kind 'missed': visible but not observed, and still standing; track_index: null where not seen; old_*: null for
-- added; position, sigma_m (along the major axis of the horizontal error ellipse), sigma_height_m and values after the
-- change, of a removed feature the last ones; marking, old_marking: as serving.features.
select
    x.feature_id, x.kind, x.changed_at, x.shift_m, x.track_index, x.frames_seen, x.frames_empty, x.other_feature_id, n.category,
    ST_X(o.geom) as old_easting_m, ST_Y(o.geom) as old_northing_m, ST_Z(o.geom) as old_height_m,
    ST_X(n.geom) as easting_m, ST_Y(n.geom) as northing_m, ST_Z(n.geom) as height_m,
    {{sigma columns of n}} as sigma_m, sqrt(n.cov_zz) as sigma_height_m,
    n.cone_height_m, coalesce(x.existence_after, n.existence_probability) as existence_probability, n.observation_count, n.version,
    n.last_seen_ns, c.changeset_no,
    {{marking columns of n}} as marking,
    {{marking columns of o}} as old_marking
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
cross join lateral (
    select coalesce(min(lower(k.system_period)), c.committed_at) as at
    from conetl.delta k
    where k.changeset_id = c.changeset_id and upper_inf(k.system_period)
    and exists (select from conetl.hold h where h.changeset_id = c.changeset_id and lower(h.system_period) = c.committed_at)
) e
join lateral (
    select v.* from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version
    order by v.system_period @> e.at desc, v.version_row_id desc
    limit 1
) n on true
left join lateral (
    select v.* from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.old_version
    order by v.system_period @> e.at desc, v.version_row_id desc
    limit 1
) o on true
where m.map_name = %(map_name)s and c.changeset_no = %(changeset_no)s and x.system_period @> e.at
order by x.feature_id;

-- name: origins
-- The change that made the state of some features: of each the last one on the road until valid_at, as the database knew it
-- at known_at. Parameters: feature_ids (uuid[]); valid_at, known_at (timestamptz; 'infinity' = latest).
-- Columns: feature_id, changed_at, drive_id, changeset_no.
select n.feature_id, o.changed_at, o.drive_id, o.changeset_no
from unnest(%(feature_ids)s::uuid[]) n (feature_id)
cross join lateral (
    select x.changed_at, d.drive_id, c.changeset_no
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    join conetl.drive d using (drive_uuid)
    where x.cell = conetl.cell_of(n.feature_id) and x.feature_id = n.feature_id
    and x.changed_at <= %(valid_at)s::timestamptz and x.system_period @> %(known_at)s::timestamptz
    order by x.changed_at desc, d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C"
    limit 1
) o;

-- name: feature_log
-- What happened to one feature, in the order of the drives on the road; superseded deltas included.
-- Parameters: feature_id.
-- Columns: changeset_no, changeset_id, drive_id, map_name, kind, changed_at; committed_at and believed_until (its system
-- period; null: current); old_version, new_version, track_index, shift_m; category, position and values after the change, of a
-- removed feature the last ones, existence_probability also where the drive changed nothing; other_feature_id (of a split the
-- common origin, of a merger the feature that is left); evidence; drive_kind (drive or import); sigma_m (along the major axis of
-- the horizontal error ellipse).
select
    c.changeset_no, c.changeset_id, d.drive_id, m.map_name, x.kind, x.changed_at, lower(x.system_period) as committed_at,
    upper(x.system_period) as believed_until, x.old_version, x.new_version,
    x.track_index, x.shift_m, v.category, ST_X(v.geom) as easting_m, ST_Y(v.geom) as northing_m, ST_Z(v.geom) as height_m,
    v.cone_height_m, coalesce(x.existence_after, v.existence_probability) as existence_probability, v.observation_count, v.suppressed,
    x.other_feature_id, x.log_likelihood_ratio, x.frames_seen, x.frames_empty, d.drive_uuid, d.kind as drive_kind,
    {{sigma columns of v}} as sigma_m
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.drive d using (drive_uuid)
join conetl.map m on m.map_id = c.map_id
join lateral (
    select * from conetl.feature_version v
    where v.cell = x.cell and v.feature_id = x.feature_id and v.version = x.new_version and v.system_period && x.system_period
    order by v.system_period desc, v.version_row_id
    limit 1
) v on true
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s
order by d.captured_from_ns, d.content_sha256 collate "C", c.idempotency_key collate "C", x.system_period;
