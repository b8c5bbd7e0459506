"""Columns of a map file -> statements about features. A column is checked at once; the first error of the first row counts."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from functools import lru_cache
from itertools import chain, islice, repeat
from typing import Annotated, Any
from uuid import UUID, uuid5

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import AfterValidator, BeforeValidator, ConfigDict, FailFast, Field, TypeAdapter, ValidationError

from conetl.files.documents import expectation, shown
from conetl.model.arrays import Floats, Ints
from conetl.model.base import ns_from_utc
from conetl.model.errors import InputError
from conetl.model.feature_classes import CONE, FEATURE_CLASSES, LINE_CLASSES
from conetl.model.map_records import ImportedFeature, MapFeature
from conetl.model.params import ImportParams
from conetl.readers.maps.tables import MapTable
from conetl.readers.trajectories.times import clock_problem

_NAMESPACE = UUID("5f0f6f0a-1c1b-4a53-9d0e-3c7a4a5be9a1")
#: 2000-01-01: signs and markings of a register may be older than any drive.
EARLIEST_NS = 946_684_800_000_000_000
#: In place of the time of an empty cell.
NO_TIME = -(2**63)
#: Cells that are Python's values at once.
_BLOCK = 20_000
#: Other English and German names of classes, in the spelling of `_checked_category`.
_SYNONYMS = {
    **dict.fromkeys(("cone", "pylon", "pylone", "leitkegel", "verkehrsleitkegel", "verkehrskegel"), CONE),
    **dict.fromkeys(("bake", "leitbake", "warnbake"), "vertical_panel"),
    **dict.fromkeys(("sign", "verkehrszeichen", "verkehrsschild"), "traffic_sign"),
    "barrel": "drum", "absperrschranke": "barricade",
}  # fmt: skip


@lru_cache(maxsize=1000)
def _checked_category(text: str) -> str:
    """The class of that name in any spelling (`Traffic Cone`) or by another name (`Leitkegel`), otherwise the text itself.

    Other first characters could be formulas for programs that open a map's CSV.
    """
    spelled = re.sub("[ -]+", "_", text.strip().lower())
    spelled = _SYNONYMS.get(spelled, spelled)
    if spelled in LINE_CLASSES:
        raise ValueError("expected a class of point objects: lines cannot be imported")
    if spelled in FEATURE_CLASSES:
        return spelled
    # Many scripts write vowels as marks beside letters.
    letters = all(c.isalnum() or c in " _.-" or unicodedata.category(c).startswith("M") for c in text)
    if not (text[:1].isalnum() and len(text) <= 64 and letters):
        raise ValueError("expected at most 64 letters, digits, spaces, _ . or -, a letter or digit first")
    return text


_Sigma = Annotated[float, Field(gt=0, le=100)]
_COVARIANCES = ("cov_en_m2", "cov_eu_m2", "cov_nu_m2")
#: Columns of a row without position, id and times: each is checked at once, which takes a tenth of the time of a row at a time.
_COLUMNS: dict[str, TypeAdapter[list[Any]]] = {
    name: TypeAdapter(Annotated[list[kind], FailFast()], config=ConfigDict(allow_inf_nan=False))  # type: ignore[arg-type, valid-type]
    for name, kind in {
        "category": Annotated[str, BeforeValidator(str), AfterValidator(_checked_category)],
        "object_height_m": Annotated[float, Field(gt=0, le=10)],
        "object_height_sigma_m": _Sigma,
        "existence_probability": Annotated[float, Field(ge=0, le=1)],
        "observation_count": Annotated[int, Field(ge=1, lt=2**31)],
        **dict.fromkeys(("sigma_e_m", "sigma_n_m", "sigma_u_m"), _Sigma),
        **dict.fromkeys(_COVARIANCES, float),
    }.items()
}
#: Of a row, behind its position: those of the covariance as in `MapFeature`, whose variances take the place of the sigmas.
_NUMBERS = (
    "sigma_e_m", "cov_en_m2", "cov_eu_m2", "sigma_n_m", "cov_nu_m2", "sigma_u_m", "object_height_m", "object_height_sigma_m",
    "existence_probability", "observation_count",
)  # fmt: skip
#: Names of columns before 0.3.
_FORMER_NAMES = {"object_height_m": "height_m", "object_height_sigma_m": "height_sigma_m"}


class StatementRows(Sequence[ImportedFeature]):
    """The rows of a table as statements. `check` goes through it column by column; of all errors the first one of the first row
    counts. Records are made where they are used: those of a million rows take gigabytes."""

    def __init__(self, table: MapTable, params: ImportParams) -> None:
        self.table = table
        self.new_ids = params.new_ids or "feature_id" not in table.columns
        self._good = len(table)
        """Rows before the first bad one."""
        self._problem: InputError | None = None
        self._defaults = {
            "category": CONE, "observation_count": 1, **dict.fromkeys(_COVARIANCES, 0.0),
            "object_height_m": params.cone_height_m, "object_height_sigma_m": params.cone_height_sigma_m,
            "existence_probability": params.existence_probability,
            **dict.fromkeys(("sigma_e_m", "sigma_n_m", "sigma_u_m"), params.sigma_m),
        }  # fmt: skip

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[one] for one in range(*index.indices(len(self)))]
        x, y, z, *covariance, height_m, height_sigma_m, existence, count = self._numbers[index].tolist()
        first_ns, last_ns, valid_from_ns = self._instants_ns[index].tolist()
        stated_id, stated_version = self._stated(index)
        feature = MapFeature(
            feature_id=stated_id if stated_id and not self.new_ids else uuid5(_NAMESPACE, f"{self._sha256}/{index}"),
            version=1, category=self.categories[index], xyz_m=(x, y, z), cov_m2=tuple(covariance),
            centre_xyz_m=(x, y, z + height_m / 2), object_height_m=height_m, object_height_sigma_m=height_sigma_m,
            existence_probability=existence, observation_count=int(count), first_seen_ns=first_ns, last_seen_ns=last_ns,
        )  # fmt: skip
        return ImportedFeature(
            feature=feature, valid_from_ns=valid_from_ns, stated_id=stated_id, stated_version=stated_version
        )

    def _stated(self, index: int) -> tuple[UUID | None, int | None]:
        """Feature id and version of a row, by which our own export is recognised; None where they are missing or invalid."""
        columns = self.table.columns
        version = str(columns["version"][index].as_py()) if "version" in columns else ""
        with suppress(KeyError, ValueError):
            stated_id = UUID(str(columns["feature_id"][index].as_py()))
            return stated_id, int(version) if version.isdecimal() and len(version) < 10 else None
        return None, None

    def _fail(self, index: int, what: object) -> None:
        self._good = index
        self._problem = InputError(f"{self.table.path}, row {index + 1}: {what}; nothing was written")

    def _require(self, good: Any, what: str) -> None:
        """good: of the first rows."""
        for index in np.flatnonzero(~good)[:1].tolist():
            self._fail(index, what)

    def require_all(self) -> None:
        """Raise InputError for the first bad row."""
        if self._problem is not None:
            raise self._problem

    def _cells(self, name: str) -> Iterator[Any]:
        """Values of the good rows, None for empty cells; some of them are in memory at a time."""
        columns = self.table.columns
        if name not in columns:
            return repeat(None, self._good)
        return chain.from_iterable(chunk.to_pylist() for chunk in columns[name][: self._good].iterchunks())

    def _checked(self, name: str) -> Iterator[list[Any]]:
        """Values of the good rows in blocks, the default for empty cells; up to the first one that is wrong."""
        default, former = self._defaults[name], _FORMER_NAMES.get(name)
        validate = _COLUMNS[name].validate_python
        values = self._cells(name)
        if former in self.table.columns:
            values = (old if value is None else value for value, old in zip(values, self._cells(former), strict=True))
        for start in range(0, self._good, _BLOCK):
            block = [default if value is None else value for value in islice(values, _BLOCK)]
            try:
                yield validate(block)
            except ValidationError as error:
                first = error.errors()[0]
                at = int(first["loc"][0])
                self._fail(start + at, f"{name} is {first['input']!r:.100}, {expectation(first)}")
                yield validate(block[:at])
                return

    def _require_ids(self) -> None:
        first: dict[UUID, int] = {}
        for index, text in enumerate(() if self.new_ids else self._cells("feature_id")):
            try:
                feature_id = UUID(str(text))
            except ValueError:
                said = "empty" if text is None else f"{shown(text)}, which is not a UUID"
                what = f"feature_id is {said} (--new-ids creates new ones)"
                return self._fail(index, what)
            if first.setdefault(feature_id, index) != index:
                return self._fail(index, f"feature_id {feature_id} is in row {first[feature_id] + 1} already")
        return None

    def check(self, xyz_m: Floats, stated_ns: int, seen_ns: Ints, sha256: str) -> None:
        """Raises InputError. xyz_m: (N, 3) in the map's CRS; seen_ns: `last_seen_at`."""
        self._require_ids()
        self.require_all()
        self.categories, self._sha256 = list(chain.from_iterable(self._checked("category"))), sha256
        self._numbers = numbers = np.empty((len(self), 3 + len(_NUMBERS)))
        numbers[:, :3] = xyz_m
        for name in (name for name in _COLUMNS if name != "category"):
            start = 0
            for block in self._checked(name):
                numbers[start : start + len(block), 3 + _NUMBERS.index(name)] = block
                start += len(block)
        e, en, eu, n, nu, u = numbers[: self._good, 3:9].T
        with np.errstate(over="ignore", invalid="ignore"):
            plane = e * e * n * n - en * en
            minor = plane * u * u + 2 * en * eu * nu - e * e * nu * nu - n * n * eu * eu
        what = "the sigmas and covariances do not form a covariance matrix (it is not positive definite)"
        self._require((plane > 0) & (minor > 0), what)
        last = np.where(seen_ns == NO_TIME, stated_ns, seen_ns)
        first = self.instants_ns("first_seen_at", last)
        valid = self.instants_ns("valid_from", first)
        last, first = last[: self._good], first[: self._good]
        what = "first_seen_at, last_seen_at and the time of the survey are not in this order"
        self._require((first <= last) & (last <= stated_ns), what)
        self._require(valid[: self._good] <= stated_ns, "valid_from is after the time of the survey")
        self.require_all()
        self._instants_ns = np.column_stack([first, last, valid])
        self.sigmas_m = np.column_stack([e, n, u])
        numbers[:, [3, 6, 8]] = self.sigmas_m**2

    def _read_plain_times(self, name: str, found_ns: Ints) -> bool:
        """Put all times of the good rows into `found_ns`, in a tenth of the time of Python; False if Arrow cannot read them."""
        columns = self.table.columns
        if name not in columns or f"{name}_us" in columns or pa.types.is_integer(columns[name].type):
            return False
        values = columns[name][: self._good]
        for zone in ("UTC", None):
            with suppress(pa.ArrowInvalid, pa.ArrowNotImplementedError):
                micros = values.cast(pa.timestamp("us", zone)).cast(pa.int64()).drop_null()
                ends = pc.min_max(micros).as_py().values()
                if len(micros) and any(clock_problem(end * 1000, EARLIEST_NS) for end in ends):
                    return False
                found_ns[values.is_valid().to_numpy()] = 1000 * micros.to_numpy()
                return True
        return False

    def instants_ns(self, name: str, default_ns: Ints | None = None) -> Ints:
        """UTC nanoseconds of the good rows, in empty cells the default; `name`_us (microseconds since 1970) is exact where a
        format's own times are not."""
        found = np.full(self._good, NO_TIME) if default_ns is None else default_ns[: self._good].copy()
        if self._read_plain_times(name, found):
            return found
        given = {name, f"{name}_us"} & self.table.columns.keys()
        for index, (micros, value) in enumerate(
            zip(self._cells(f"{name}_us"), self._cells(name), strict=True) if given else ()
        ):
            try:
                if micros is not None or value is not None:
                    found[index] = _instant_ns(name, micros, value)
            except ValueError as error:
                self._fail(index, error)
                break
        return found[: self._good]


@lru_cache(maxsize=10_000)
def _instant_ns(name: str, micros: Any, value: Any) -> int:
    """UTC nanoseconds of a cell, of the first one if both have a value. Raises ValueError."""
    if micros is not None:
        name, value = f"{name}_us", micros
        if not (isinstance(micros, int | float) and math.isfinite(micros) and abs(micros) < 9e15):
            raise ValueError(f"{name} is {shown(micros)}, expected microseconds since 1970")
        time_ns = int(micros) * 1000
    else:
        try:
            # 2026/03/02, as some programs write it
            stated = value if isinstance(value, datetime) else datetime.fromisoformat(str(value).replace("/", "-"))
            time_ns = ns_from_utc(stated if stated.tzinfo else stated.replace(tzinfo=UTC))  # UTC without an offset
        except (ValueError, OverflowError):
            raise ValueError(f"{name} is {shown(value)}, expected a time like 2026-03-02T10:00:00Z") from None
    if problem := clock_problem(time_ns, EARLIEST_NS):
        raise ValueError(f"{name}, {shown(value)}, {problem}")
    return time_ns
