"""data/SHA256SUMS holds for every shipped file."""

from __future__ import annotations

import hashlib
import subprocess

from tests.folders import ROOT

DATA = ROOT / "data"
FOR_PEOPLE = {"README.md", "SHA256SUMS", "models/README.md", "models/conetl-road-10.reliability.png"}


def test_checksums_hold_for_every_shipped_file() -> None:
    listed = dict(reversed(line.split("  ", 1)) for line in (DATA / "SHA256SUMS").read_text().splitlines())
    found = {name: hashlib.sha256((DATA / name).read_bytes()).hexdigest() for name in listed}
    assert found == listed
    shipped = subprocess.run(["git", "ls-files"], cwd=DATA, capture_output=True, text=True, check=True).stdout.split()
    assert set(shipped) - FOR_PEOPLE == set(listed)
