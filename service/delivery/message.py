"""Message of a webhook about an event: {type, timestamp, data}, and an id that is the same on every attempt.

It is signed as standardwebhooks.com has it: HMAC-SHA256 by a shared secret.
"""

import base64
import binascii
import hashlib
import hmac
import json
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

MAX_BYTES = 20_000
TEST = "webhook.test"
PREFIX = "whsec_"
KEY_BYTES = range(24, 65)


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A message, ready to be signed."""

    id: str
    type: str
    event: int | None  # its number; None for a test
    body: bytes


def message_of(event: Mapping[str, Any], instance_id: str) -> Message:
    """Return the message of an event as the feed has it; one that is too large comes without its details."""
    told = [event["seq"], event["at"], event["type"], event["subject"]]
    # not of the instance: that is another one after a restored backup, and the event the same
    digest = hashlib.sha256(json.dumps(told).encode()).hexdigest()[:16]
    body = _body(event, instance_id, event["data"])
    if len(body) >= MAX_BYTES:
        body = _body(event, instance_id, None)
    return Message(id=f"event-{event['seq']}-{digest}", type=event["type"], event=event["seq"], body=body)


def trial_message(instance_id: str, at: str) -> Message:
    """Return a message without an event, to test an endpoint."""
    event = {"seq": None, "at": at, "type": TEST, "subject": "test"}
    return Message(id=f"test-{uuid.uuid4()}", type=TEST, event=None, body=_body(event, instance_id, {}))


def _body(event: Mapping[str, Any], instance_id: str, details: Mapping[str, Any] | None) -> bytes:
    data = {
        "instance_id": instance_id,
        "seq": event["seq"],
        "subject": event["subject"],
        "details": details,
    }
    document = {"type": event["type"], "timestamp": event["at"], "data": data}
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")


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
