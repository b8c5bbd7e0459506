-- Purpose: what millions of features cost. The constraint that no two versions of a feature hold at once looks at what is believed
-- now only, and indexes that no query uses are dropped.
--
-- Versions are written with an open system period, and the one change a row may see is that this period is closed at the instant of
-- a later changeset of its map. So two versions that are believed at the same system time were open together when the later one was
-- written, and that is what the constraint refuses; closed rows need not be in its index (half the cost of a merge). That nobody
-- tampered with closed ones is what the audit overlapping_periods looks at.

alter table conetl.feature_version drop constraint no_overlap;
alter table conetl.feature_version add constraint no_overlap
    exclude using gist (feature_id with =, valid_period with &&) where (upper_inf(system_period));

-- One believed row per number of a version, as before; now over all rows, because it is also the way to the history of a feature.
drop index conetl.feature_version_believed;
create unique index feature_version_believed
    on conetl.feature_version (feature_id, version, coalesce(upper(system_period), 'infinity'));

-- A changeset's versions are found through its deltas.
drop index conetl.feature_version_by_changeset;
-- A database holds a few maps: whoever wants all features of one reads the table.
drop index conetl.feature_by_map;

-- Raw records may go when they are old; what was made of them stays. A drive without them cannot be compared with the map again.
alter table conetl.drive add column pruned_at timestamptz;
comment on column conetl.drive.pruned_at is
    'When its detections, stereo matches and positions were deleted by policy; null while they are there.';
