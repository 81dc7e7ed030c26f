"""A feed of the daemon for one outlet, followed by the reference client, with a durable cursor."""

import logging
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from service.base.abandonable import start_abandonable
from service.base.errors import ServiceError
from service.bridge.client import BridgeClient
from service.bridge.reference_client import Position, Reporter, Step, follow, keep_position, kept_position

log = logging.getLogger(__name__)


class BridgeError(ServiceError):
    """Something that the bridge needs is missing, or refused; says what."""


async def feed(client: BridgeClient, cursor_file: Path, **options: Any) -> AsyncIterator[Step]:
    """Yield the steps of a feed; one is delivered when the next is asked for, and only then its position is stored.

    A step has items, a gap, or another history. After a kill, or an error while it was delivered, it comes again.
    `options` are those of `follow`, which waits on a thread that nothing waits for. Raises `BridgeError` when the file
    of the cursor cannot be used.
    """
    position = _position(cursor_file)
    steps = follow(client, position, **options)
    reporter = Reporter(position, lambda text: log.warning("%s: %s", cursor_file.stem, text))

    def advance(delivered: Position | None) -> Step:
        if delivered is not None:
            keep_position(cursor_file, delivered)
        return next(steps)

    delivered: Position | None = None
    try:
        while True:
            step = await start_abandonable(f"follow {cursor_file.stem}", advance, delivered)
            reporter.note(step)
            delivered = None
            if step.trouble is None and step.position != position:
                yield step
                position = delivered = step.position
    except OSError as err:  # of the file: the client has none
        raise BridgeError(f"{cursor_file}: {err.strerror}") from err
    finally:
        client.abandon()


def _position(cursor_file: Path) -> Position:
    try:
        cursor_file.parent.mkdir(parents=True, exist_ok=True)
        return kept_position(cursor_file)
    except (OSError, ValueError, TypeError) as err:
        raise BridgeError(
            f"{cursor_file} is no cursor that can be used ({err}): without the file all results come again"
        ) from err
