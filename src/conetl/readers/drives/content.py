"""The hash of everything that was read of a drive: equal content has an equal hash, wherever the folder is."""

from __future__ import annotations

import hashlib
from pathlib import Path


class ContentHash:
    """Collects files by name relative to the drive folder, in any order."""

    def __init__(self, *, headers_only: bool = False) -> None:
        """headers_only: only the first and last bytes of images are checked, and images are not part of the hash."""
        self.headers_only = headers_only
        self.read_ahead: dict[Path, bytes] = {}
        """Images that were read before their turn, for their size."""
        self._files: dict[str, bytes] = {}

    def add(self, name: str, data: bytes) -> str:
        """Add one file that was read; its SHA-256. Names are posix paths relative to the drive folder."""
        found = hashlib.sha256(data)
        self._files[name] = found.digest()
        return found.hexdigest()

    def hexdigest(self) -> str:
        """SHA-256 over sorted names and the hashes of their bytes."""
        total = hashlib.sha256()
        for name in sorted(self._files):
            total.update(name.encode() + b"\0" + self._files[name])
        return total.hexdigest()
