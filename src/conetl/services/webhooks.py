"""Messages to the operator's own servers: signed as the Standard Webhooks specify (version 1, HMAC-SHA256).

A receiver recomputes the signature of `id.timestamp.body` with the shared secret, and knows a repeated message by its id.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import time
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

import httpx

from conetl.model.errors import InputError

#: For connecting, and for each step of the answer.
_TIMEOUT_S = 10.0
_SHOWN = 200


def receiver_name(url: str) -> str:
    """Host and the beginning of the hash of an address, which may hold a secret. Raises InputError if it is no address."""
    parts = urlsplit(url)
    if parts.scheme not in ("https", "http") or not parts.hostname:
        raise InputError(f"CONETL_WEBHOOKS: {url[:_SHOWN]!r}: expected an address like https://example.org/conetl")
    return f"{parts.hostname} {hashlib.sha256(url.encode()).hexdigest()[:8]}"


def signature(secret: str, message_id: str, timestamp_s: int, body: bytes) -> str:
    """The header `webhook-signature`."""
    signed = f"{message_id}.{timestamp_s}.".encode() + body
    return "v1," + base64.b64encode(hmac.digest(secret.encode(), signed, "sha256")).decode()


def post(url: str, secret: str, message_id: str, message: Mapping[str, Any]) -> str | None:
    """Send one message; returns why it did not arrive, else None. Any answer of 2xx counts as arrived; redirects do not."""
    body, timestamp_s = json.dumps(message, default=str).encode(), int(time.time())
    headers = {
        "content-type": "application/json", "webhook-id": message_id, "webhook-timestamp": str(timestamp_s),
        "webhook-signature": signature(secret, message_id, timestamp_s, body),
    }  # fmt: skip
    try:
        with httpx.stream("POST", url, content=body, headers=headers, timeout=_TIMEOUT_S) as answer:
            return None if answer.is_success else f"the answer was {answer.status_code} {answer.reason_phrase}"[:_SHOWN]
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        return f"{type(error).__name__}: {error}"[:_SHOWN]
