"""Endpoints that are made over REST: in the store, sealed with a key that lies beside the database and in no backup.

Messages are signed with the secret itself, so a hash, as of keys of the interface, would not do; and of a URL the end
is secret as often as not.
"""

import base64
import json
import secrets
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

from cryptography.fernet import Fernet, InvalidToken
from pydantic import SecretStr

from drivers.files.bounded import read_bounded
from drivers.files.durable import replacing
from service.base.errors import ProblemError, ProblemKind, TooManyError
from service.delivery import table
from service.delivery.progress import enabled
from service.delivery.settings import KEY_BYTES, MAX_ENDPOINTS, PREFIX, WebhookEndpoint
from service.store import audit
from service.store.events import EventType

SEAL, MAX_SEAL_BYTES = "webhooks.key", 100
"""File beside the database with the key of the seal."""


class WebhookConflictError(ProblemError):
    """The endpoint is of the configuration, or has another secret, or cannot be read any more."""

    kinds = (ProblemKind("webhook-conflict", HTTPStatus.CONFLICT, "The webhook cannot be changed so"),)


@dataclass(frozen=True, slots=True)
class Definitions:
    """Endpoints of the store."""

    endpoints: tuple[WebhookEndpoint, ...]
    unreadable: tuple[str, ...]
    """Names of those whose seal cannot be broken, as after a restore on another machine."""


def new_secret() -> SecretStr:
    """Return a secret, `whsec_` and 24 random bytes as base64."""
    return SecretStr(PREFIX + base64.b64encode(secrets.token_bytes(KEY_BYTES.start)).decode())


def definitions(connection: sqlite3.Connection, folder: Path) -> Definitions:
    """Return the endpoints that were made over REST, by name; `folder` has the key."""
    rows = connection.execute("SELECT name, sealed FROM webhooks WHERE sealed IS NOT NULL ORDER BY name")
    found = {name: _unsealed(folder, name, sealed) for name, sealed in rows}
    return Definitions(
        tuple(each for each in found.values() if each is not None),
        tuple(name for name, each in found.items() if each is None),
    )


def define(
    connection: sqlite3.Connection, folder: Path, wanted: WebhookEndpoint, is_given: bool, who: str
) -> bool:
    """Make or change an endpoint, and return whether it is new.

    `wanted` has one secret, that of a new one; one that is there keeps its own. A new one begins with the next event, a
    changed one is tried again at once. Raises `WebhookConflictError` if the secret is given, and the one that is there
    has another, `TooManyError` if there are `MAX_ENDPOINTS`.
    """
    name = wanted.name
    before = _find(connection, folder, name)
    if before is None:
        (n,) = connection.execute(
            "SELECT count(*) FROM webhooks WHERE sealed IS NOT NULL AND name <> ?", (name,)
        ).fetchone()
        if n >= MAX_ENDPOINTS:
            raise TooManyError("webhooks", f"there are {MAX_ENDPOINTS} webhooks of REST: remove one of them")
        table.begin_anew(connection, name)
    elif not is_given or wanted.secrets == before.secrets[:1]:
        wanted = replace(wanted, secrets=before.secrets)
        table.keep(connection, name, enabled(table.progress_of(connection, name)))
    else:
        raise WebhookConflictError(
            f"webhook {name} has another secret: PUT webhooks/{name}/secret changes it"
        )
    _keep(connection, folder, wanted)
    action = "webhook defined" if before is None else "webhook changed"
    audit.note(
        connection, who, action, name, before=None if before is None else _facts(before), after=_facts(wanted)
    )
    return before is None


def rotate(connection: sqlite3.Connection, folder: Path, name: str, secret: SecretStr, who: str) -> None:
    """Sign with another secret as well.

    Until `end_rotation` the one that the receiver knows stays: a further rotation replaces only the newest.
    """
    endpoint = require(connection, folder, name)
    _keep(connection, folder, replace(endpoint, secrets=(secret, endpoint.secrets[-1])))
    audit.note(connection, who, "webhook secret rotated", name)


def end_rotation(connection: sqlite3.Connection, folder: Path, name: str, who: str) -> None:
    """Sign with the newest secret alone from now on."""
    endpoint = require(connection, folder, name)
    _keep(connection, folder, replace(endpoint, secrets=endpoint.secrets[:1]))
    audit.note(connection, who, "webhook rotation ended", name)


def remove(connection: sqlite3.Connection, name: str, who: str) -> bool:
    """Remove an endpoint, readable or not, and return whether it was there; what came of it stays until a new one."""
    removed = connection.execute(
        "UPDATE webhooks SET sealed = NULL WHERE name = ? AND sealed IS NOT NULL", (name,)
    )
    if removed.rowcount:
        audit.note(connection, who, "webhook removed", name)
    return removed.rowcount > 0


def require(connection: sqlite3.Connection, folder: Path, name: str) -> WebhookEndpoint:
    """Return an endpoint that was made over REST; raise `WebhookConflictError` if there is none that can be read."""
    if (found := _find(connection, folder, name)) is None:
        raise WebhookConflictError(f"webhook {name} is not there any more, or cannot be read: define it anew")
    return found


def _find(connection: sqlite3.Connection, folder: Path, name: str) -> WebhookEndpoint | None:
    row = connection.execute("SELECT sealed FROM webhooks WHERE name = ?", (name,)).fetchone()
    return None if row is None or row[0] is None else _unsealed(folder, name, row[0])


def _facts(endpoint: WebhookEndpoint) -> Mapping[str, Any]:
    return {"url": endpoint.shown_url, "events": endpoint.events}


def _keep(connection: sqlite3.Connection, folder: Path, endpoint: WebhookEndpoint) -> None:
    document = {
        "url": endpoint.url,
        "events": endpoint.events,
        "secrets": [secret.get_secret_value() for secret in endpoint.secrets],
    }
    if not (path := folder / SEAL).exists():
        with replacing(path, mode=0o600) as unfinished:
            unfinished.write_bytes(Fernet.generate_key())
    sealed = _fernet(folder).encrypt(json.dumps(document).encode()).decode()
    connection.execute("UPDATE webhooks SET sealed = ? WHERE name = ?", (sealed, endpoint.name))


def _unsealed(folder: Path, name: str, sealed: str) -> WebhookEndpoint | None:
    """Return the endpoint of a row; None if its key is not there, or is another one."""
    try:
        document = json.loads(_fernet(folder).decrypt(sealed))
        return WebhookEndpoint(
            name=name,
            url=document["url"],
            events=tuple(map(EventType, document["events"])),
            secrets=tuple(map(SecretStr, document["secrets"])),
        )
    except (WebhookConflictError, InvalidToken, ValueError, KeyError):
        return None


def _fernet(folder: Path) -> Fernet:
    # no OSError: the store would wait for its disk
    try:
        return Fernet(read_bounded(folder / SEAL, MAX_SEAL_BYTES))
    except (OSError, ValueError) as err:
        raise WebhookConflictError(f"{SEAL} beside the database cannot be read: {err}") from err
