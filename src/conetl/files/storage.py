"""Files on disk and objects in S3-compatible storage, by the same few methods.

A drive may be at `s3://bucket/drive`. Its readers use `pathlib` methods only, which `UPath` (universal-pathlib over fsspec)
has for objects too. Objects are read when they are needed and never copied to disk; a bounded part of the bytes read last stays
in memory, since an image is hashed and then decoded. So do images of files, by their hash, until the drive is done: a drive
whose images are larger than the bound is read again. Credentials and endpoint come from the usual environment
(AWS_ACCESS_KEY_ID, AWS_PROFILE, AWS_ENDPOINT_URL ...) or the machine's role, never from conetl's own settings.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import stat
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

from cachetools import LRUCache
from upath import UPath

from conetl.files.documents import library_errors
from conetl.model.errors import StorageError

#: Bytes that stay in memory for their next reader: the 256 images of half a chunk, of a megabyte each. What is pushed out
#: between its hash and its decoding is read twice.
CACHE_BYTES = 256 * 2**20
#: SHA-256 of a missing file: that of no bytes.
NO_FILE_SHA256 = hashlib.sha256().hexdigest()
#: Errors of a missing file; all others are about the storage.
_NO_SUCH_FILE = frozenset({errno.ENOENT, errno.ENOTDIR, errno.ELOOP})
#: Packages whose errors are about the storage.
_STORAGE_ERRORS = frozenset({"botocore", "aiobotocore", "aiohttp", "s3fs"})
#: `Path` collapses two slashes into one.
_ADDRESS = re.compile(r"^(s3|memory):/{1,2}(?=[^/])")


#: The bytes that were used last, by address (objects) or SHA-256.
_kept: LRUCache[str, bytes] = LRUCache(CACHE_BYTES, getsizeof=len)
_lock = threading.Lock()


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
    with library_errors(
        f"{address}: objects of this kind cannot be read", ImportError, hint="; pip install 'conetl[s3]'"
    ):
        return cast(Path, UPath(address))


def is_remote(path: Path) -> bool:
    """Whether a path is in object storage."""
    return not isinstance(path, Path)


#: What is wrong with a path that exists, but is not `is_present`. Reading a pipe would wait for its other end.
NOT_A_FILE = "this is a folder, a pipe or a broken link, not a file"


def is_present(path: Path) -> bool:
    """Whether a file exists on this machine. Raises OSError where the storage fails (`Path.is_file` returns False)."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError as error:
        if error.errno in _NO_SUCH_FILE:
            return False
        raise


def links_of(drive: Path) -> Iterator[Path]:
    """The symbolic links in a drive's folder, those in folders that they lead to, and those of the files beside the drive.

    The latter are the calibration and the settings of a bag, which are read too. Nothing of an object's path.
    """
    if is_remote(drive):
        return
    real = drive.resolve()
    for folder in {drive.absolute().parent, real.parent}:
        beside = {*folder.glob("calib_*.txt"), *(folder / f"{real.stem}.{name}" for name in ("drive.yaml", "rig.yaml"))}
        yield from (path for path in beside if path.is_symlink())
    folders, seen = [drive] if drive.is_dir() else [], {real}
    while folders:
        with suppress(OSError), os.scandir(folders.pop()) as listed:  # what cannot be listed is not read either
            for entry in listed:
                path = Path(entry.path)
                if entry.is_symlink():
                    yield path
                    with suppress(OSError):
                        if path.is_dir() and (target := path.resolve()) not in seen:
                            seen.add(target)
                            folders.append(path)
                elif entry.is_dir():
                    folders.append(path)


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn errors of the object storage into one StorageError that names the object.

    Errors of local files do not change. A missing object is a property of the drive and remains a FileNotFoundError.
    """
    try:
        yield
    except FileNotFoundError:
        raise
    except Exception as error:
        # s3fs raises Python's own errors when the storage is busy or fails, a token has expired, or access is denied.
        is_of_storage = isinstance(error, OSError) or type(error).__module__.split(".")[0] in _STORAGE_ERRORS
        if not is_remote(path) or not is_of_storage:
            raise
        raise StorageError(
            f"{path}: cannot be read from the storage: {error}. Check the address, AWS_ENDPOINT_URL and the credentials "
            "(AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_PROFILE, or the machine's role). Nothing was written."
        ) from error


def forget_listing(path: Path) -> None:
    """Forget cached listings of the storage, which may have changed. No effect for files."""
    if is_remote(path):
        cast(Any, path).fs.invalidate_cache()


def object_bytes(path: Path) -> bytes:
    """All bytes of an object, from the cache if it was read recently. Raises OSError like `Path.read_bytes`."""
    data = recall(str(path))
    if data is None:
        with storage_errors(path):
            data = path.read_bytes()
        _keep(str(path), data)
    return data


def fetch(paths: Sequence[Path], *, fresh: bool = False) -> None:
    """Fetch several objects at once into the cache of `object_bytes`, without missing ones. No effect for files.

    fresh: fetch cached ones again, as they may have changed. The cache has `CACHE_BYTES`: fetch as many as will be read next.
    """
    objects = [path for path in paths if is_remote(path)]
    if fresh:
        _drop(*objects)
    wanted = [path for path in objects if recall(str(path)) is None]
    if not wanted:
        return
    storage = cast(Any, wanted[0]).fs
    with storage_errors(wanted[0]):
        found = storage.cat([cast(Any, path).path for path in wanted], on_error="omit")
    for path in wanted:
        data = found.get(cast(Any, path).path)
        if isinstance(data, bytes):
            _keep(str(path), data)


def remember(path: Path, sha256: str, data: bytes) -> None:
    """Keep the bytes of a file or an object under their hash for `recall`, in this process."""
    if is_remote(path):
        _drop(path)
    _keep(sha256, data)


def recall(key: str) -> bytes | None:
    """Bytes with this hash that `remember` kept, or of the object at an address; None if evicted, or if another process read
    them."""
    with _lock:
        return _kept.get(key)


def _keep(key: str, data: bytes) -> None:
    with _lock, suppress(ValueError):  # larger than all of it
        _kept[key] = data


def _drop(*objects: Path) -> None:
    with _lock:
        for path in objects:
            _kept.pop(str(path), None)


def forget_all() -> None:
    """Free the memory of `remember` and `object_bytes`."""
    with _lock:
        _kept.clear()
