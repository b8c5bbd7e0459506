-- How many changes a changeset made is one mapping. It was eight columns for point objects, each named as a kind, and a mapping for
-- stretches of lane markings.

alter table conetl.changeset add column change_counts jsonb;
update conetl.changeset c
set change_counts = jsonb_build_object(
    'points', (
        select coalesce(jsonb_object_agg(k.kind, k.n), '{}')
        from (
            values
            ('added', c.added_count), ('confirmed', c.confirmed_count), ('moved', c.moved_count), ('removed', c.removed_count),
            ('missed', c.missed_count), ('height_changed', c.height_changed_count), ('split', c.split_count), ('merged', c.merged_count)
        ) k (kind, n)
        where k.n <> 0
    ),
    'lines', c.line_counts
);
alter table conetl.changeset
    alter column change_counts set not null,
    drop column added_count, drop column confirmed_count, drop column moved_count, drop column removed_count, drop column missed_count,
    drop column height_changed_count, drop column split_count, drop column merged_count, drop column line_counts;
comment on column conetl.changeset.change_counts is
    'Number of changes as committed: {"points": {kind: n}, "lines": {kind: n}}, of point objects and of stretches of lane markings; kinds '
    'without changes are left out.';
