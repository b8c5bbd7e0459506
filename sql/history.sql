-- What changesets did to features.

-- name: changesets
-- Changesets of a map, newest first, or the one of an idempotency key.
-- Parameters: map_name; idempotency_key (null: all). Columns: as CommittedChangeset.
-- A drive that was committed on hold changed the map when it was released: its counts and effective_at are from then.
select
    c.changeset_no, c.changeset_id, d.drive_id, d.kind, c.drive_uuid, c.idempotency_key, c.params_sha256, c.model_sha256,
    c.code_version, c.committed_at, e.at as effective_at,
    case when e.at = c.committed_at then c.change_counts else (
        select '{"points": {}, "lines": {}}' || jsonb_object_agg(p.part, p.counts)
        from (
            select k.part, jsonb_object_agg(k.kind, k.n) as counts
            from (
                select case when x.of_line then 'lines' else 'points' end as part, x.kind, count(*) as n
                from conetl.delta x
                where x.changeset_id = c.changeset_id and upper_inf(x.system_period)
                group by part, x.kind
            ) k
            group by k.part
        ) p
    ) end as change_counts,
    c.frame_pair_count, c.detection_count, c.match_count, c.position_count, c.track_count, c.marking_count, c.rejection_count,
    d.captured_from_ns, d.captured_to_ns, d.content_sha256, d.expected_frame_count, m.srid as map_srid,
    h.reason is null and exists (select from conetl.active_drive a where a.changeset_id = c.changeset_id) as counts,
    h.reason as hold
from conetl.changeset c
join conetl.map m using (map_id)
join conetl.drive d using (drive_uuid)
join conetl.effect e using (changeset_id)
left join conetl.on_hold h using (changeset_id)
where m.map_name = %(map_name)s and (%(idempotency_key)s::text is null or c.idempotency_key = %(idempotency_key)s)
order by c.changeset_no desc;

-- name: changes_of_changeset
-- What one changeset did to each feature that it judged, as committed (or as released, if it was committed on hold). An
-- earlier drive that arrived later may have replaced it since: see feature_log. Parameters: map_name; changeset_no; origin_m, from
-- which xyz_m, old_xyz_m and lines count.
-- Columns: kind 'missed': visible but not observed, and still standing; track_index: null where not seen; old_*: before
-- the move, null for other kinds; the others of conetl.feature_state after the change, of a removed feature the last position.
select
    x.kind, x.changed_at, x.shift_m, x.track_index, x.frames_seen, x.frames_empty, x.other_feature_id, x.feature_id, x.category,
    n.easting_m, n.northing_m, n.ellipsoidal_height_m, conetl.offset_m(n.geom, %(origin_m)s::float8[]) as xyz_m,
    conetl.offset_m(o.geom, %(origin_m)s::float8[]) as old_xyz_m, x.sigma_m, n.sigma_u_m, x.object_height_m,
    x.existence_probability, x.observation_count,
    {{marking columns of n}} as marking, {{marking columns of o}} as old_marking
from conetl.changeset_changes(%(map_name)s, %(changeset_no)s) x
join conetl.feature_state n using (version_row_id)
left join conetl.feature_state o on o.version_row_id = x.old_row_id
order by x.feature_id;

-- name: feature_log
-- What happened to one feature, in the order of the drives on the road; superseded deltas included.
-- Parameters: feature_id.
-- Columns: of conetl.feature_delta (known_from, known_to: its system period; null while current); category, position and values
-- after the change, of a removed feature the last position, existence_probability also where the drive changed nothing.
select
    x.changeset_no, x.changeset_id, x.drive_id, x.map_name, x.kind, x.changed_at, lower(x.system_period) as known_from,
    upper(x.system_period) as known_to, x.old_version, x.new_version, x.track_index, x.shift_m, s.category,
    s.easting_m, s.northing_m, s.ellipsoidal_height_m, s.object_height_m,
    coalesce(x.existence_after, s.existence_probability) as existence_probability, s.observation_count, s.suppressed,
    x.other_feature_id, x.log_likelihood_ratio, x.frames_seen, x.frames_empty, x.drive_uuid, x.drive_kind, s.sigma_m
from conetl.feature_delta x
join lateral conetl.state_after(
    x.cell, x.feature_id, x.new_version, x.changeset_id,
    coalesce(upper(x.system_period) - interval '1 microsecond', 'infinity')
) s on true
where x.cell = conetl.cell_of(%(feature_id)s) and x.feature_id = %(feature_id)s
order by x.drive_order, x.system_period;
