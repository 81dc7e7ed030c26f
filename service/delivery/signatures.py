"""Signatures of webhooks as standardwebhooks.com has them: HMAC-SHA256 by a shared secret."""

import base64
import binascii
import hashlib
import hmac
from collections.abc import Iterable

PREFIX = "whsec_"
KEY_BYTES = range(24, 65)


def key_of(secret: str) -> bytes:
    """Return the key that a secret stands for; raise `ValueError` if it is none, without telling it."""
    if not secret.startswith(PREFIX):
        raise ValueError(f"a secret begins with {PREFIX}, see the guide")
    try:
        key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    except (binascii.Error, ValueError):
        raise ValueError(f"a secret is {PREFIX} and base64") from None
    if len(key) not in KEY_BYTES:
        raise ValueError(f"a secret is base64 of 24 to 64 bytes, not of {len(key)}")
    return key


def signatures(keys: Iterable[bytes], message_id: str, timestamp_s: int, body: bytes) -> str:
    """Return the header `webhook-signature`: one signature for each key, during a rotation of secrets two."""
    signed = f"{message_id}.{timestamp_s}.".encode() + body
    digests = (hmac.digest(key, signed, hashlib.sha256) for key in keys)
    return " ".join(f"v1,{base64.b64encode(digest).decode()}" for digest in digests)
