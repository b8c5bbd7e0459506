"""Files on disk and objects in S3-compatible storage, by the same few methods.

The path of a drive may be `s3://bucket/drive`. Its readers use `pathlib` methods only, which `UPath` (universal-pathlib over
fsspec) has for objects too. Objects are not copied to disk; the bytes read last are cached in memory up to a limit, since an
image is hashed and then decoded. Credentials and endpoint come from the usual environment (AWS_ACCESS_KEY_ID, AWS_PROFILE,
AWS_ENDPOINT_URL ...) or the machine's role, never from conetl's own settings.
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

#: Size of the cache: the 256 images of half a chunk, of half a megabyte each, for two tasks. An object that leaves the cache
#: between its hash and its decoding is fetched twice.
CACHE_BYTES = 256 * 2**20
#: SHA-256 of a missing file: that of no bytes.
NO_FILE_SHA256 = hashlib.sha256().hexdigest()
#: Errors of a missing file; all others are about the storage.
_NO_SUCH_FILE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.ELOOP})
#: Objects fetched at the same time.
_AT_ONCE = 16
#: `Path` replaces two slashes by one.
_ADDRESS = re.compile(r"^(s3|memory):/{1,2}(?=[^/])")
_lock = threading.Lock()
_kept: OrderedDict[str, bytes] = OrderedDict()


def as_path(text: str | Path) -> Path:
    """The path of a file, or of an object if the text is an address such as s3://bucket/drive.

    The latter is not a `pathlib.Path`, but has the methods that readers use. Raises InputError where the package that reads such
    addresses is not installed.
    """
    if not isinstance(text, str | Path):
        return text  # an object's path
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
    """Whether a path is an object's."""
    return not isinstance(path, Path)


def is_present(path: Path) -> bool:
    """Whether a file exists on this machine. Raises OSError where the storage fails (`Path.is_file` returns False)."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError as error:
        if error.errno in _NO_SUCH_FILE:
            return False
        raise


@contextmanager
def reached(path: Path) -> Iterator[None]:
    """Errors of the object storage become one StorageError that names the object. Errors of local files do not change.

    A missing object is a property of the drive and remains a FileNotFoundError.
    """
    try:
        yield
    except Exception as error:
        if not is_remote(path) or not _is_of_storage(error):
            raise
        raise StorageError(
            f"{path}: cannot be read from the storage: {error}. Check the address, AWS_ENDPOINT_URL and the credentials "
            "(AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_PROFILE, or the machine's role). Nothing was written."
        ) from error


def _is_of_storage(error: Exception) -> bool:
    """s3fs raises Python's own errors for those of the storage (too busy, internal error, expired token, no access)."""
    if isinstance(error, OSError):
        return not isinstance(error, FileNotFoundError)
    return type(error).__module__.split(".")[0] in _STORAGE_ERRORS


_STORAGE_ERRORS = frozenset({"botocore", "aiobotocore", "aiohttp", "s3fs"})


def forget_listing(path: Path) -> None:
    """Forget cached listings of the storage, which may have changed. No effect for files."""
    if is_remote(path):
        cast(Any, path).fs.invalidate_cache()


def object_bytes(path: Path) -> bytes:
    """All bytes of an object, from the cache if possible. Raises OSError like `Path.read_bytes`."""
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
    """Fetch several objects at once into the cache of `object_bytes`, without missing ones. No effect for files.

    fresh: fetch cached ones again, as they may have changed. The cache has `CACHE_BYTES`: fetch as many as will be read next.
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
    """The same paths; objects are fetched in batches before they are yielded. fresh: see `fetch`."""
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
