-- Purpose: what drives say for a feature and against it, whether it changes the feature or not.
--
-- A drive that looked at a feature's spot and did not see it leaves a delta of kind 'missed', which makes no version (old_version =
-- new_version), like a confirmation that changes nothing. So evidence has a system period, is played again when a drive comes
-- late, and costs one row per drive and feature in view. log_likelihood_ratio: ln p(what the drive saw | it stands) / p(same | it does
-- not); existence_after: belief after the drive; frames_seen, frames_empty: frame pairs in which it was seen, and in which its spot
-- was in view without a cone. Null in rows of mergers, and in those written before this migration.

alter table conetl.drive add column absence_figures jsonb;
comment on column conetl.drive.absence_figures is
    'What is measured of the detector that looked (P(detect | height, hidden share)) and its score threshold; null: not kept.';

alter table conetl.delta add column other_feature_id uuid;  -- of a split: what was both; of a merger: what is left
alter table conetl.delta add column log_likelihood_ratio float8;
alter table conetl.delta add column existence_after float8 check (existence_after between 0 and 1);
alter table conetl.delta add column frames_seen integer check (frames_seen >= 0);
alter table conetl.delta add column frames_empty integer check (frames_empty >= 0);
alter table conetl.delta drop constraint delta_kind_check;
alter table conetl.delta add constraint delta_kind_check check (
    kind in ('added', 'confirmed', 'moved', 'removed', 'missed', 'height_changed', 'split', 'merged')
);
alter table conetl.delta add constraint a_miss_changes_nothing check (
    kind <> 'missed' or (old_version = new_version and existence_after is not null)
);
-- The few features that are in doubt are found without reading all that was ever seen.
create index delta_missed on conetl.delta (feature_id, old_version) where kind = 'missed' and upper_inf(system_period);

alter table conetl.changeset add column missed_count integer not null default 0;
alter table conetl.changeset add column height_changed_count integer not null default 0;
alter table conetl.changeset add column split_count integer not null default 0;
alter table conetl.changeset add column merged_count integer not null default 0;

create view conetl.sighting_evidence as
select
    m.map_name, x.feature_id, c.drive_uuid, x.changeset_id, x.kind,
    x.kind not in ('missed', 'removed') as seen,
    x.log_likelihood_ratio, x.existence_after, x.frames_seen, x.frames_empty,
    x.old_version, x.new_version, x.changed_at as observed_at, x.system_period
from conetl.delta x
join conetl.changeset c using (changeset_id)
join conetl.map m using (map_id)
where x.kind <> 'merged';
comment on view conetl.sighting_evidence is
    'One row per drive and feature that it saw, or looked for and did not see; believed now where upper_inf(system_period).';

-- Drives that saw a feature and that looked for it in vain, up to an instant on the road, as known at an instant of the database; and
-- the belief in its version of that number after them (null: no drive missed that version).
create function conetl.feature_evidence(
    feature_id uuid, version integer, valid_at timestamptz default 'infinity', known_at timestamptz default 'infinity',
    out seen_count integer, out missed_count integer, out existence_after float8
)
language sql stable
as $$
    select
        count(*) filter (where x.kind not in ('missed', 'removed', 'merged'))::integer,
        count(*) filter (where x.kind in ('missed', 'removed'))::integer,
        (
            array_agg(
                x.existence_after
                order by d.captured_from_ns desc, d.content_sha256 collate "C" desc, c.idempotency_key collate "C" desc
            ) filter (where x.kind = 'missed' and x.old_version = $2)
        )[1]
    from conetl.delta x
    join conetl.changeset c using (changeset_id)
    join conetl.drive d using (drive_uuid)
    where x.feature_id = $1 and x.changed_at <= $3 and x.system_period @> $4
$$;
comment on function conetl.feature_evidence is
    'Counts of drives that saw a feature and that looked in vain, and the belief after the latest of the latter.';
