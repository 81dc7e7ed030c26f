"""Who may connect to the OPC UA server, sign in, and give orders; and a log of who may not."""

import logging
import time
from collections import defaultdict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.ua.uaerrors import UaStatusCodeError
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from service.bridge.opcua.certificates import (
    is_trusted,
    keep_rejected,
    load_certificate,
    now_utc,
    thumbprint,
    trouble_of,
)
from service.bridge.opcua.passwords import hash_password, is_password
from service.bridge.opcua.settings import OpcUaUser

log = logging.getLogger(__name__)

Attempt = tuple[str, str | None]
"""Address and name of a user."""
MAX_WRONG = 10
"""Attempts with a wrong password in a minute, after which all of this user from this address are refused."""
MAX_LINES = 30
"""Refusals that are logged in a minute."""
MAX_ATTEMPTS = 1000
PER_S = 60.0


class ClientRefusedError(ServiceError):
    """A client may not what it asks for; says why."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(code)
        self.reason = reason

    def __str__(self) -> str:
        return self.reason


@dataclass
class PlantUser(User):
    """A user, and the key of the daemon that orders are given with; the daemon decides which."""

    key_file: Path | None = None
    may_order: bool = False
    """True with a key of its own, or with that of the bridge."""


class Access:
    """Checks certificates and users. Asked on the event loop, by the sessions of one server."""

    def __init__(self, folder: Path, users: Sequence[OpcUaUser]) -> None:
        """`folder` has `trusted` and `rejected`; raise `CertificateFileError` for a user's that cannot be read."""
        self._folder = folder
        self._by_name = {user.name: user for user in users}
        self._certificates = [
            (load_certificate(user.certificate).public_bytes(Encoding.DER), user)
            for user in users
            if user.certificate is not None
        ]
        self._nobodys = hash_password("")  # takes as long as a password that is there
        self._wrong: dict[Attempt, deque[float]] = defaultdict(deque)
        self._told: deque[float] = deque()
        self._n_untold = 0

    def check_client(self, der: bytes | None) -> None:
        """Raise `ClientRefusedError` unless a client's certificate is trusted and valid."""
        if der is None:
            raise ClientRefusedError(ua.StatusCodes.BadCertificateInvalid, "shows no certificate")
        if trouble := trouble_of(x509.load_der_x509_certificate(der), now_utc()):
            raise ClientRefusedError(
                ua.StatusCodes.BadCertificateTimeInvalid, f"certificate {thumbprint(der)} {trouble}"
            )
        if not is_trusted(self._folder, der):
            kept = keep_rejected(self._folder, der)
            raise ClientRefusedError(
                ua.StatusCodes.BadCertificateUntrusted,
                f"certificate {thumbprint(der)} is not trusted; if it is to be, move {kept} to"
                f" {self._folder / 'trusted'}",
            )

    def get_user(
        self,
        iserver: object,
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Authenticate a user, None when that fails; without a name and a certificate it is an anonymous reader."""
        user: OpcUaUser | None = None
        if username is not None:
            known = self._by_name.get(username)
            stored = self._nobodys if known is None or known.password is None else known.password
            is_right = is_password(password or "", stored)
            user = known if is_right and stored is not self._nobodys else None
        elif certificate is not None:
            is_valid = trouble_of(x509.load_der_x509_certificate(certificate), now_utc()) is None
            user = next((who for der, who in self._certificates if der == certificate and is_valid), None)
        else:
            return PlantUser(role=UserRole.Anonymous)
        if user is None:
            return None
        may_order = user.orders or user.key_file is not None
        return PlantUser(UserRole.User, user.name, user.key_file, may_order)

    def check_pace(self, attempt: Attempt) -> None:
        """Raise `ClientRefusedError` for a user whose password was wrong too often in the last minute."""
        if attempt in self._wrong and len(_recent(self._wrong[attempt])) >= MAX_WRONG:
            raise ClientRefusedError(
                ua.StatusCodes.BadUserAccessDenied, f"was refused {MAX_WRONG} times within a minute"
            )

    def note_wrong(self, attempt: Attempt) -> None:
        """Count an attempt to sign in that was refused."""
        if len(self._wrong) > MAX_ATTEMPTS:
            self._wrong.clear()
        if len(self._wrong[attempt]) < MAX_WRONG:
            self._wrong[attempt].append(time.monotonic())

    def tell(self, address: str, what: object) -> None:
        """Log what was refused, in a bounded number of lines."""
        if isinstance(what, ServiceError | UaStatusCodeError) and not isinstance(what, ClientRefusedError):
            what = ua.status_codes.get_name_and_doc(what.code)[0]
        if len(_recent(self._told)) >= MAX_LINES:
            self._n_untold += 1
            return
        more = f" ({self._n_untold} refusals before it were not logged)" if self._n_untold else ""
        self._n_untold = 0
        self._told.append(time.monotonic())
        log.warning("refused: %s %s%s", address, str(what)[:500], more)


def _recent(times: deque[float]) -> deque[float]:
    while times and times[0] < time.monotonic() - PER_S:
        times.popleft()
    return times
