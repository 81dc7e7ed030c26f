"""Screens that wait to be signed in, each with a code for people and a secret of its own (RFC 8628).

What the standard calls device code is the secret, and user code the code. Both are short-lived and used once; the
secrets are in memory alone, so no pairing outlives a restart.
"""

import secrets
import time
from collections.abc import Iterable

from service.store import Store
from service.store.keys import sha256_of
from service.store.pairings import Pairing, UnknownPairingError, key_of, new_code, note_pairing
from service.web.clients import Attempts, origin_of, pause_problem
from service.web.problems import Problem

MOST_OPEN = 16
"""Screens that wait at a time; six digits have a million values."""
MOST_OF_ADDRESS = 4
"""Screens of one address that may wait; a further one takes the place of its oldest."""
POLL_S = 3


class Pairings:
    """Screens that wait, by the SHA-256 of their secret."""

    def __init__(self) -> None:
        self._open: dict[str, Pairing] = {}
        self._begun = Attempts()

    async def begin(self, store: Store, address: str, user_agent: str) -> tuple[Pairing, str]:
        """Return a new code with the secret of its screen.

        Raises the problem 429 for too many of one address or of all, and `StoreError` if the store cannot be written.
        """
        store.require_writable()
        if (pause_s := self._begun.pause_s(address, time.monotonic())) > 0:
            raise pause_problem("codes were asked for", address, pause_s)
        self._begun.note(address, time.monotonic())
        self._keep(each for each in self._open.values() if each.is_open(time.time()))
        own = [each for each in self._open.values() if origin_of(each.address) == origin_of(address)]
        if len(own) >= MOST_OF_ADDRESS:
            self._keep(each for each in self._open.values() if each is not own[0])
        if len(self._open) >= MOST_OPEN:
            raise Problem(
                429, "too-many-pairings", f"{MOST_OPEN} screens wait to be signed in", retry_after_s=60
            )
        codes = {each.code for each in self._open.values()}
        pairing = Pairing(new_code(codes), address, user_agent, int(time.time()))
        secret = secrets.token_urlsafe(32)
        self._open[sha256_of(secret)] = pairing
        await store.write(note_pairing, pairing, codes | {pairing.code})
        return pairing, secret

    def key_of(self, store: Store, secret: str) -> str | None:
        """Return the SHA-256 of the key that the screen with a secret was given, once; None while it waits.

        Raises `UnknownPairingError` if there is no such screen, or its code has run out.
        """
        pairing = self._open.get(sha256_of(secret))
        if pairing is None or not pairing.is_open(time.time()):
            raise UnknownPairingError
        key_sha256 = store.read_here(lambda connection: key_of(connection, pairing.code))
        if key_sha256 is not None:
            self._keep(each for each in self._open.values() if each is not pairing)
        return key_sha256

    def _keep(self, pairings: Iterable[Pairing]) -> None:
        kept = set(pairings)
        self._open = {secret: each for secret, each in self._open.items() if each in kept}
