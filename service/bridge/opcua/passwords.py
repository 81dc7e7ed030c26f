"""Passwords of OPC UA users, of which only a salted hash is kept (scrypt, RFC 7914)."""

import base64
import hashlib
import hmac
import re
import secrets

COST, BLOCK, PARALLEL = 2**14, 8, 1
"""16 MB of memory and some 50 ms for each attempt."""
STORED = r"scrypt:(\d{4,6}):(\d{1,2}):(\d{1,2}):([A-Za-z0-9+/=]{16,64}):([A-Za-z0-9+/=]{40,96})"
MAX_BYTES = 1024


def hash_password(password: str) -> str:
    """Return the only form in which a password is stored."""
    salt = secrets.token_bytes(16)
    made = (base64.b64encode(part).decode() for part in (salt, _hash(password, salt, COST, BLOCK, PARALLEL)))
    return ":".join(["scrypt", str(COST), str(BLOCK), str(PARALLEL), *made])


def is_password(password: str, stored: str) -> bool:
    """Compare a password with its stored form."""
    found = re.fullmatch(STORED, stored)
    if found is None or len(password.encode()) > MAX_BYTES:
        return False
    cost, block, parallel = map(int, found.groups()[:3])
    salt, kept = (base64.b64decode(text) for text in found.groups()[3:])
    return hmac.compare_digest(_hash(password, salt, cost, block, parallel), kept)


def _hash(password: str, salt: bytes, cost: int, block: int, parallel: int) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=cost, r=block, p=parallel, dklen=32, maxmem=2**28)
