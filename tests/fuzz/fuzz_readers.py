"""Every reader on mutated files: a result, rejections or a ConetlError within limits on time, memory and message length.

    python -m tests.fuzz.fuzz_readers [--cases 10000] [--reader kitti] [--seed 1] [--first 0] [--keep FOLDER]

Case n of a reader is the same on every run with the same seed. Each reader runs in a process of its own with limited memory;
a process that dies or hangs costs one finding, and the next case starts a new one.
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
MAX_S = 2.0
MAX_BYTES = 1 << 30
#: A process that does not come back; processor time is measured against MAX_S.
HANG_S = 20
MAX_MESSAGE = 2000
#: When the files were written, which a proposal may tell.
WRITTEN_S = 1_772_445_600


class FindingError(Exception):
    """What a reader must not do."""


@dataclass
class Result:
    """Outcome of the cases of one reader."""

    reader: str
    cases: int = 0
    slowest_s: float = 0.0
    slowest_case: int = -1
    peak_bytes: int = 0
    findings: dict[str, list[int]] = field(default_factory=dict)
    """Cases by what happened."""

    def add(self, what: str, case: int) -> None:
        self.findings.setdefault(what, []).append(case)

    def row(self) -> str:
        bad = sum(map(len, self.findings.values()))
        return (
            f"{self.reader:18} {self.cases:7,} {len(self.findings):4} ({bad:5}) {self.slowest_s:7.3f} s "
            f"(case {self.slowest_case:5}) {self.peak_bytes / 2**20:6.0f} MB"
        )


# --------------------------------------------------------------------------- one process


def run_cases(name: str, first: int, cases: int, seed: int, keep: Path | None) -> None:
    """Child: run cases and print one JSON line per finding, and one with the figures at the end."""
    from tests.fuzz.readers import READERS

    warnings.simplefilter("ignore")
    reader = READERS[name]
    with tempfile.TemporaryDirectory(dir=_memory_folder()) as folder:
        valid = valid_files(reader, Path(folder))
        _limit_memory()
        slowest = (0.0, -1)
        for case in range(first, first + cases):
            print(json.dumps({"case": case}), flush=True)
            faulthandler.dump_traceback_later(HANG_S, exit=True)
            took_s, problem, _ = run_case(reader, valid, random.Random(f"{seed}/{name}/{case}"), keep)
            faulthandler.cancel_dump_traceback_later()
            slowest = max(slowest, (took_s, case))
            if problem:
                print(json.dumps({"finding": problem, "case": case}), flush=True)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        print(json.dumps({"slowest": slowest, "peak": peak}), flush=True)


class Valid(NamedTuple):
    """What a reader has written, and has read before the first case."""

    path: Path
    scratch: Path
    files: dict[Path, bytes]
    found: object
    """What is read of them."""


def valid_files(reader: Any, folder: Path) -> Valid:
    """The reader's own valid files, which it must read."""
    work, scratch = folder / "in", folder / "out"
    work.mkdir()
    path = reader.write(work)
    for file in work.rglob("*"):
        os.utime(file, (WRITTEN_S, WRITTEN_S))
    found = reader.read(path, scratch)
    files = {file: file.read_bytes() for file in sorted(work.rglob("*")) if file.is_file()}
    return Valid(path, scratch, files, found)


def _memory_folder() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _limit_memory() -> None:
    """MAX_BYTES more than what the libraries have mapped."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MAX_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


class Outcome(NamedTuple):
    """Of one case."""

    took_s: float
    problem: str | None
    """What went wrong; None if nothing did."""
    found: object
    """What was read, or the error that says why it cannot be."""


def run_case(reader: Any, valid: Valid, rng: random.Random, keep: Path | None = None) -> Outcome:
    """Read the files with some of them mutated. They are as before afterwards."""
    from tests.fuzz.mutations import is_text, mutated

    path, scratch, files, _ = valid
    names = [*files]
    weights = [4 if is_text(files[name]) else 1 for name in names]
    changed = sorted(set(rng.choices(names, weights, k=rng.choice((1, 1, 1, 2)))))
    for file in changed:
        file.write_bytes(mutated(rng, files[file]))
        os.utime(file, (WRITTEN_S, WRITTEN_S))
        if keep is not None:
            target = keep / file.relative_to(path.parent)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes())
    start = time.process_time()
    problem, found = _read(reader, path, scratch)
    took_s = time.process_time() - start
    for file in changed:
        file.write_bytes(files[file])
        os.utime(file, (WRITTEN_S, WRITTEN_S))
    return Outcome(took_s, problem or (f"{took_s:.0f} s: slower than {MAX_S:g} s" if took_s > MAX_S else None), found)


def _read(reader: Any, path: Path, scratch: Path) -> tuple[str | None, object]:
    """What went wrong, and what was read."""
    from conetl.model.errors import ConetlError
    from conetl.model.rejections import Rejection

    found: object = None
    try:
        found = reader.read(path, scratch)
        for item in found if isinstance(found, list) else ():
            if isinstance(item, Rejection):
                item.model_dump_json()
                _check_message(item.detail)
    except FindingError as finding:
        return f"{finding} at a rejection", found
    except ConetlError as error:
        try:
            _check_message(str(error))
        except FindingError as finding:
            return f"{finding} {_where(error)}", error
        return None, error
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:150]!r} {_where(error)}", error
    return None, found


def _check_message(text: str) -> None:
    text.encode()
    if not text.replace("\n", " ").isprintable():
        raise FindingError(f"control characters in a message: {text[:150]!r}")
    if len(text) > MAX_MESSAGE:
        raise FindingError(f"a long message: {text[:150]!r}")


def _where(error: BaseException) -> str:
    """The innermost line of conetl."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "/src/conetl/" in f.filename]
    return f"at {frames[-1].filename.split('/src/conetl/')[1]}:{frames[-1].lineno}" if frames else "outside of conetl"


# --------------------------------------------------------------------------- parent


def fuzz(name: str, cases: int, seed: int, first: int = 0, keep: Path | None = None) -> Result:
    """All cases of a reader; a new process after each that died."""
    result = Result(name)
    at, end = first, first + cases
    while at < end:
        last = at - 1
        for line in _child_lines(name, at, end - at, seed, keep):
            if "finding" in line:
                result.add(_kind(line["finding"]), line["case"])
            elif "case" in line:
                last = line["case"]
            elif "slowest" in line:
                result.slowest_s, result.slowest_case = max(
                    (result.slowest_s, result.slowest_case), tuple(line["slowest"])
                )
                result.peak_bytes = max(result.peak_bytes, line["peak"])
                last = end
            else:
                result.add(line["died"], last)
        if last < at:
            raise RuntimeError(f"{name}: the reader does not read its own valid file: {result.findings}")
        result.cases += min(last + 1, end) - at
        at = last + 1
    return result


def _kind(text: str) -> str:
    """Findings of one line and type of error are one."""
    head, _, where = text.rpartition(" at ")
    return f"{head.split(':')[0]} at {where}" if head else text[:150]


def _child_lines(name: str, first: int, cases: int, seed: int, keep: Path | None) -> Iterator[dict[str, Any]]:
    command = [sys.executable, "-m", "tests.fuzz.fuzz_readers", "--child", "--reader", name, "--first", str(first),
               "--cases", str(cases), "--seed", str(seed), *(("--keep", str(keep)) if keep else ())]  # fmt: skip
    with tempfile.TemporaryFile("w+") as errors, subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True, bufsize=1, errors="replace",
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    ) as child:  # fmt: skip
        assert child.stdout is not None
        for line in child.stdout:
            if line.startswith("{"):
                yield json.loads(line)
        if child.wait() != 0:
            errors.seek(0)
            said = errors.read()
            hung = "Timeout" in said
            lines = [line.strip() for line in said.splitlines() if "/src/conetl/" in line][:1] or said.splitlines()[-1:]
            yield {"died": f"{'hung' if hung else f'died with {child.returncode}'}: {' '.join(lines)[-200:]}"}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000, help="per reader")
    parser.add_argument("--reader", action="append", help="one of them (may be repeated); default all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--keep", type=Path, help="write the mutated files of each case to this folder")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        run_cases(options.reader[0], options.first, options.cases, options.seed, options.keep)
        return 0
    from tests.fuzz.readers import READERS

    print(
        f"seed {options.seed}, cases from {options.first} on\nreader               cases findings (cases) slowest, peak memory"
    )
    bad = 0
    for name in options.reader or READERS:
        result = fuzz(name, options.cases, options.seed, options.first, options.keep)
        print(result.row(), flush=True)
        for what, cases in sorted(result.findings.items(), key=lambda item: -len(item[1])):
            bad += 1
            print(f"    {len(cases):5} x {what}  (cases {', '.join(map(str, cases[:4]))})", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
