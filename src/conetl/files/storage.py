"""Files on disk and objects in S3-compatible storage, by the same few methods.

A drive may lie at `s3://bucket/drive`. Its readers use `pathlib` methods only, which `UPath` (universal-pathlib over fsspec)
has for objects too. Objects are read when they are needed and never copied to disk; a bounded part of the bytes read last stays
in memory, since a image is hashed and then decoded. Credentials and endpoint come from the usual environment
(AWS_ACCESS_KEY_ID, AWS_PROFILE, AWS_ENDPOINT_URL ...) or the machine's role, never from conetl's own settings.
"""

from __future__ import annotations

import errno
import hashlib
import re
import stat
import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from upath import UPath

from conetl.model.errors import InputError, StorageError

#: Bytes of objects that stay in memory for their next reader: the 256 images of half a chunk, of half a megabyte each, for two
#: tasks. What is pushed out between its hash and its decoding is fetched twice.
CACHE_BYTES = 256 * 2**20
#: SHA-256 where there is no file: of nothing.
NO_FILE_SHA256 = hashlib.sha256().hexdigest()
#: What the system says where there is no such file; whatever else it says is about the storage.
_NO_SUCH_FILE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.ELOOP})
#: Objects asked for at the same time.
_AT_ONCE = 16
#: `Path` makes one slash of two.
_ADDRESS = re.compile(r"^(s3|memory):/{1,2}(?=[^/])")
_lock = threading.Lock()
_kept: OrderedDict[str, bytes] = OrderedDict()


def as_path(text: str | Path) -> Path:
    """A file's path, or the place of an object where the text is an address such as s3://bucket/drive.

    The latter is no `pathlib.Path`, but has the methods of one that readers need. Raises InputError where what reads such
    addresses is not installed.
    """
    if not isinstance(text, str | Path):
        return text  # an object's place already
    found = _ADDRESS.match(str(text))
    if found is None:
        return Path(text)
    address = f"{found[1]}://{str(text)[found.end() :]}"
    try:
        return cast(Path, UPath(address))
    except ImportError as error:
        raise InputError(
            f"{address}: objects of this kind cannot be read: {error}; pip install 'conetl[s3]'"
        ) from error


def is_remote(path: Path) -> bool:
    """Whether a place is an object's."""
    return not isinstance(path, Path)


def is_present(path: Path) -> bool:
    """Whether there is a file on this machine. `Path.is_file` says no where the storage does not answer, this raises OSError."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError as error:
        if error.errno in _NO_SUCH_FILE:
            return False
        raise


@contextmanager
def reached(path: Path) -> Iterator[None]:
    """Storage that does not answer, or refuses, becomes one error that names the object. Files of this machine raise as ever.

    That there is no such object is a property of the drive, and stays a FileNotFoundError.
    """
    try:
        yield
    except Exception as error:
        if not is_remote(path) or not _is_of_storage(error):
            raise
        raise StorageError(
            f"{path}: the storage does not give it: {error}. Look at the address, at AWS_ENDPOINT_URL and at the credentials "
            "(AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_PROFILE, or the machine's role). Nothing was written."
        ) from error


def _is_of_storage(error: Exception) -> bool:
    """s3fs makes Python's own errors of what the storage says of itself (too busy, internal error, expired token, no access)."""
    if isinstance(error, OSError):
        return not isinstance(error, FileNotFoundError)
    return type(error).__module__.split(".")[0] in _STORAGE_ERRORS


_STORAGE_ERRORS = frozenset({"botocore", "aiobotocore", "aiohttp", "s3fs"})


def forget_listing(path: Path) -> None:
    """Look at the storage again: what was listed earlier in this process may have changed. Nothing to do for files."""
    if is_remote(path):
        cast(Any, path).fs.invalidate_cache()


def object_bytes(path: Path) -> bytes:
    """All bytes of an object, from memory where they were read lately. Raises OSError like `Path.read_bytes`."""
    key = str(path)
    with _lock:
        if key in _kept:
            _kept.move_to_end(key)
            return _kept[key]
    with reached(path):
        data = path.read_bytes()
    _keep(key, data)
    return data


def fetch(paths: Sequence[Path], *, fresh: bool = False) -> None:
    """Ask for several objects at once, for `object_bytes` to find; what is missing is left to it. Nothing to do for files.

    fresh: also for those that are in memory, as somebody may have written them anew since. More than `CACHE_BYTES` of them push
    each other out: ask for as many as will be read next.
    """
    with _lock:
        if fresh:
            for path in paths:
                _kept.pop(str(path), None)
        wanted = [path for path in paths if is_remote(path) and str(path) not in _kept]
    if not wanted:
        return
    storage = cast(Any, wanted[0]).fs
    with reached(wanted[0]):
        found = storage.cat([cast(Any, path).path for path in wanted], on_error="omit")
    for path in wanted:
        data = found.get(cast(Any, path).path)
        if isinstance(data, bytes):
            _keep(str(path), data)


def in_batches(paths: Sequence[Path], *, fresh: bool = False) -> Iterator[Path]:
    """The same paths; objects are asked for some at a time, before they are handed out. fresh: see `fetch`."""
    for first in range(0, len(paths), _AT_ONCE):
        batch = paths[first : first + _AT_ONCE]
        fetch(batch, fresh=fresh)
        yield from batch


def _keep(key: str, data: bytes) -> None:
    with _lock:
        _kept[key] = data
        _kept.move_to_end(key)
        while len(_kept) > 1 and sum(map(len, _kept.values())) > CACHE_BYTES:
            _kept.popitem(last=False)
