"""Work zones from the map's history: cones chained along the road and tracked over time, so that a zone keeps its id.

Time advances by changesets. At each one the present cones of a neighbourhood are chained along the road; a chain that shares
cones with a zone continues that zone, whatever was added, moved or removed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple
from uuid import NAMESPACE_URL, UUID, uuid5

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from conetl.geometry.linear_reference import spacing_beside
from conetl.model.arrays import Floats, Ints
from conetl.model.base import Vec3
from conetl.model.map_records import FeatureVersion, MapFeature
from conetl.model.work_zone_params import WorkZoneParams
from conetl.model.work_zone_records import DrivePath, ZoneHistory
from conetl.workzones.road_lines import axes_of, passes_beside

_NAMESPACE = uuid5(NAMESPACE_URL, "https://conetl.example/work_zone")
#: A car needs this width between cones; a gap this wide separates two zones.
_CAR_WIDTH_M = 2.0
_CELL_M = 20.0


def zones_over_time(
    versions: Iterable[FeatureVersion],
    paths: Sequence[DrivePath],
    params: WorkZoneParams,
    *,
    map_name: str,
    at_ns: int | None = None,
) -> list[ZoneHistory]:
    """Every work zone up to an instant on the road (None: the last change), present and ended, by start and id.

    versions: of every feature in the current database state, in any order. Versions and drives that begin after `at_ns` are
    ignored.
    """
    known = [
        v if v.valid_to_ns is None or at_ns is None or v.valid_to_ns <= at_ns else v.model_copy(update={"valid_to_ns": None})
        for v in versions
        if at_ns is None or v.valid_from_ns <= at_ns
    ]  # fmt: skip
    driven = [path for path in paths if at_ns is None or path.captured_from_ns <= at_ns]
    zones = [
        zone
        for near in _neighbourhoods(known, params)
        for zone in _zones_of_neighbourhood(near, driven, params, map_name)
    ]
    return sorted(zones, key=lambda zone: (zone.start_ns, str(zone.zone_id)))


def with_kept_ids(zones: Sequence[ZoneHistory], kept: Mapping[UUID, UUID]) -> list[ZoneHistory]:
    """Zones under the ids that they keep; kept: by the id that is computed. No two get one id: the older one keeps it."""
    taken = {zone.zone_id for zone in zones}
    given: dict[UUID, UUID] = {}
    for zone in zones:
        if (zone_id := kept.get(zone.zone_id)) is not None and zone_id not in taken:
            given[zone.zone_id] = zone_id
            taken.add(zone_id)
    return [
        replace(zone, zone_id=given.get(zone.zone_id, zone.zone_id),
            merged_into=None if zone.merged_into is None else given.get(zone.merged_into, zone.merged_into))
        for zone in zones
    ]  # fmt: skip


class Stood(NamedTuple):
    """A work zone as it is stored: when, as ISO 8601 of UTC (end None: still), and where its devices last stood."""

    start: str
    end: str | None
    devices_m: Sequence[Vec3]


def same_zones(before: Mapping[UUID, Stood], now: Mapping[UUID, Stood], within_m: float) -> dict[UUID, UUID]:
    """New zones that are zones of before under another id: they stood at the same time, with at least half of the devices in the
    same places; those with most first.

    before, now: zones whose ids are not in the other one.
    """
    ranked = []
    for old_id, old in before.items():
        tree = KDTree(np.array(old.devices_m)[:, :2])
        for new_id, new in now.items():
            shared = int(np.count_nonzero(tree.query(np.array(new.devices_m)[:, :2])[0] <= within_m))
            at_once = (old.end is None or new.start <= old.end) and (new.end is None or old.start <= new.end)
            if at_once and 2 * shared >= min(len(old.devices_m), len(new.devices_m)):
                ranked.append((-shared, str(old_id), str(new_id), old_id, new_id))
    found: dict[UUID, UUID] = {}
    for *_, old_id, new_id in sorted(ranked):
        if new_id not in found and old_id not in found.values():
            found[new_id] = old_id
    return found


def chain_stations(stations_m: Floats, params: WorkZoneParams) -> list[Ints]:
    """Groups of cones (C,) along one road, sorted by station, separated by gaps over `link_factor` times the spacing beside
    them."""
    order = np.argsort(stations_m, kind="stable")
    gaps = np.diff(stations_m[order])
    cuts = []
    for index, gap in enumerate(gaps):
        if gap > min(max(params.min_link_m, params.link_factor * spacing_beside(gaps, index)), params.max_link_m):
            cuts.append(index + 1)
    return list(np.split(order, cuts))


def clusters(features: Sequence[MapFeature], passes: Sequence[DrivePath], params: WorkZoneParams) -> list[set[UUID]]:
    """Groups of cones present at one instant along roads. Rows on both sides of a drive are two groups."""
    if not features:
        return []
    places = np.array([feature.xyz_m[:2] for feature in features])
    found = []
    for axis in axes_of(places, passes, params):
        for group in chain_stations(axis.stations_m, params):
            for one in _both_sides(group, axis.offsets_m) if axis.source == "drives" else [group]:
                parts = chain_stations(axis.stations_m[one], params) if len(one) < len(group) else [np.arange(len(one))]
                found += [{features[int(axis.members[one[k]])].feature_id for k in part} for part in parts]
    return found


def _both_sides(group: Ints, offsets_m: Floats) -> list[Ints]:
    """The group, or two groups if the driven path has cones on both sides and a car fits between them."""
    right, left = group[offsets_m[group] < 0], group[offsets_m[group] >= 0]
    if not len(right) or not len(left) or offsets_m[left].min() - offsets_m[right].max() < _CAR_WIDTH_M:
        return [group]
    return [right, left]


def _neighbourhoods(versions: Sequence[FeatureVersion], params: WorkZoneParams) -> list[list[FeatureVersion]]:
    """Versions in groups too far apart ever to be in one zone; by cells, because one location has many versions."""
    if not versions:
        return []
    xy_m = np.array([version.feature.xyz_m[:2] for version in versions])
    cells, cell = np.unique(xy_m // _CELL_M, axis=0, return_inverse=True)
    reach_m = float(np.hypot(params.max_link_m, 2 * params.max_path_offset_m)) + _CELL_M * 2**0.5
    pairs = KDTree(cells * _CELL_M).query_pairs(reach_m, output_type="ndarray")
    # The versions of one feature belong together, however far it was moved: features are nodes of the graph, too.
    feature = len(cells) + np.unique([str(version.feature_id) for version in versions], return_inverse=True)[1]
    a, b = np.concatenate([pairs, np.column_stack([cell, feature])]).T
    size = int(feature.max()) + 1
    labels = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(size, size)), directed=False)[1]
    groups: dict[int, list[FeatureVersion]] = defaultdict(list)
    for label, version in zip(labels[cell].tolist(), versions, strict=True):
        groups[label].append(version)
    return list(groups.values())


@dataclass
class _Live:
    """A zone at the current instant."""

    zone: ZoneHistory
    members: set[UUID]


def _zones_of_neighbourhood(
    versions: Sequence[FeatureVersion], paths: Sequence[DrivePath], params: WorkZoneParams, map_name: str
) -> list[ZoneHistory]:
    in_order = sorted(versions, key=lambda v: v.valid_from_ns)
    since = {v.feature_id: v.valid_from_ns for v in reversed(in_order)}  # of each feature, the first one
    steps = {v.changeset_id: v.valid_from_ns for v in in_order}  # of each changeset, the last one
    passes = passes_beside(paths, np.array([v.feature.xyz_m[:2] for v in versions]), params)
    starting = [v for v in in_order if v.present and not v.suppressed]
    next_start = 0
    shown: dict[UUID, FeatureVersion] = {}
    gone: dict[UUID, int] = {}
    live: list[_Live] = []
    ended: list[ZoneHistory] = []
    instants: dict[int, UUID] = {}
    for changeset_id, instant_ns in sorted(steps.items(), key=lambda step: (step[1], str(step[0]))):
        instants.setdefault(instant_ns, changeset_id)
    for instant_ns, changeset_id in instants.items():
        while next_start < len(starting) and starting[next_start].valid_from_ns <= instant_ns:
            shown[starting[next_start].feature.feature_id] = starting[next_start]
            next_start += 1
        for key, version in list(shown.items()):
            if version.valid_to_ns is not None and version.valid_to_ns <= instant_ns:
                gone[key] = version.valid_to_ns
                del shown[key]
        standing = {key: version.feature for key, version in shown.items()}
        found = clusters(list(standing.values()), [p for p in passes if p.captured_from_ns <= instant_ns], params)
        assigned = _assign_chains(live, found, standing, params)
        live, over = _end(live, standing, gone, instant_ns)
        ended += over
        for number, cluster in enumerate(found):
            if number not in assigned and len(cluster) >= params.min_cones:
                founder = min(cluster, key=lambda one: (since[one], str(one)))
                zone_id = uuid5(_NAMESPACE, f"{map_name}/{founder}/{changeset_id}")
                zone = ZoneHistory(zone_id, start_ns=since[founder], end_ns=None, merged_into=None, cones=())
                live.append(_Live(zone, set(cluster)))
        for one in live:
            cones = tuple(standing[key] for key in sorted(one.members, key=lambda key: (since[key], str(key))))
            same = {cone.feature_id for cone in one.zone.cones} == one.members
            earlier, since_ns = one.zone.phases, instant_ns
            if earlier and same:
                since_ns, earlier = earlier[-1][0], earlier[:-1]
            one.zone = replace(one.zone, cones=cones, phases=(*earlier, (since_ns, cones)))
    return [*ended, *(one.zone for one in live)]


def _assign_chains(
    live: Sequence[_Live], found: Sequence[set[UUID]], standing: dict[UUID, MapFeature], params: WorkZoneParams
) -> set[int]:
    """Assign the current chains to the live zones (sets their members); returns the numbers of the assigned chains.

    Most shared cones first, then the older zone. A zone without present cones continues in a chain at the same location.
    """
    ranked = []
    for index, one in enumerate(live):
        # Without present cones all were replaced between two drives: other features at the same location.
        replaced = one.members.isdisjoint(standing)
        for number, cluster in enumerate(found):
            near = replaced and _nearest_m(one.zone.cones, [standing[key] for key in cluster]) <= params.min_link_m
            if (shared := len(one.members & cluster)) or near:
                ranked.append((-shared, one.zone.start_ns, str(one.zone.zone_id), number, index))
    assigned: set[int] = set()
    given: dict[int, set[UUID]] = {}
    for _, _, _, number, index in sorted(ranked):
        if number not in assigned and index not in given:
            assigned.add(number)
            given[index] = found[number]
    for index, one in enumerate(live):
        one.members = set(given.get(index, set()))
    # An unassigned chain whose cones all belonged to zones was split off; it may found a zone.
    return assigned


def _nearest_m(some: Sequence[MapFeature], others: Sequence[MapFeature]) -> float:
    a, b = (np.array([feature.xyz_m[:2] for feature in group]) for group in (some, others))
    return float(np.min(KDTree(a).query(b)[0]))


def _end(
    live: Sequence[_Live], standing: dict[UUID, MapFeature], gone: dict[UUID, int], instant_ns: int
) -> tuple[list[_Live], list[ZoneHistory]]:
    """Live zones, and ended ones: their last cone is gone, or an older zone has their cones."""
    going = [one for one in live if one.members]
    over = []
    for one in live:
        if one.members:
            continue
        left = {cone.feature_id for cone in one.zone.cones if cone.feature_id in standing}
        successor = next((other.zone.zone_id for other in going if other.members & left), None)
        ends = [gone[cone.feature_id] for cone in one.zone.cones if cone.feature_id in gone]
        end_ns = instant_ns if left or not ends else max(ends)
        over.append(replace(one.zone, end_ns=end_ns, merged_into=successor))
    return going, over
