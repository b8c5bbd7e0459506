"""An S3-compatible storage on loopback: a real server of moto, which s3fs is led to by the usual environment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest
import s3fs
from moto.server import ThreadedMotoServer

from conetl.files.storage import as_path

BUCKET = "survey"


@contextmanager
def object_storage() -> Iterator[pytest.MonkeyPatch]:
    """A server with one empty bucket; what is set of the environment is taken back at the end."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    try:
        with pytest.MonkeyPatch.context() as environment:
            environment.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
            environment.setenv("AWS_ACCESS_KEY_ID", "somebody")
            environment.setenv("AWS_SECRET_ACCESS_KEY", "something")
            environment.setenv("AWS_DEFAULT_REGION", "us-east-1")
            s3fs.S3FileSystem.clear_instance_cache()  # those of an earlier test know another server
            as_path(f"s3://{BUCKET}").mkdir()
            yield environment
    finally:
        # All servers of a process have their objects in common.
        httpx.post(f"http://{host}:{port}/moto-api/reset", trust_env=False).raise_for_status()
        server.stop()
