"""The errors of the service; `WorkerFailure` alone is no `ServiceError`: it reports a bug or a broken environment."""

from http import HTTPStatus
from typing import Any, ClassVar, NamedTuple


class ServiceError(Exception):
    """Root of the errors that the service raises on purpose."""


class SettingsError(ServiceError):
    """The configuration cannot be used; names the file and every wrong field."""


class StoreError(ServiceError):
    """The result store cannot be opened, or a write is wrong; a disk that refuses only holds it."""


class ProblemKind(NamedTuple):
    """Kind of problem of RFC 9457, as an error declares it: the last part of its `type`, its status and its title."""

    name: str
    status: HTTPStatus
    title: str


class ProblemError(ServiceError):
    """A request that cannot be granted as things are; REST answers with the problem of its kind and its members."""

    kinds: ClassVar[tuple[ProblemKind, ...]] = ()
    """Kinds of problem that it may be; one that does not say is the first."""
    retry_after_s: ClassVar[int | None] = None

    def __init__(self, detail: str, kind: str | None = None, **members: object) -> None:
        super().__init__(detail)
        self.kind = kind or self.kinds[0].name
        self.members: dict[str, Any] = members


class InvalidRequestError(ProblemError):
    """The request contradicts itself or the store; names the field."""

    kinds = (ProblemKind("invalid-request", HTTPStatus.UNPROCESSABLE_ENTITY, "The request is not valid"),)


class TooManyError(ProblemError):
    """As many things are stored as there may be; says which of them must go, or what to do instead."""

    kinds = tuple(
        ProblemKind(f"too-many-{things}", HTTPStatus.CONFLICT, f"Too many {things}")
        for things in ("consumers", "products", "sievings", "webhooks")
    )

    def __init__(self, things: str, detail: str) -> None:
        super().__init__(detail, f"too-many-{things}")


class VolumeModelError(ServiceError):
    """Coefficients of the volume correction cannot be read, or cannot be fitted to the given data."""


class StandardsError(ServiceError):
    """The tables of sieves and specifications cannot be used; names the file and every wrong field."""


class ClusterError(ServiceError):
    """The cluster cannot be used, or is gone."""


class UsageError(ServiceError):
    """The arguments of a command contradict each other or the files they name."""


class WorkerFailure(Exception):  # noqa: N818 - no `ServiceError`
    """A job in a worker process ended with an unexpected exception, whose traceback this carries as text.

    `is_hosts`: the host had no descriptor or no room for it, whatever the job was.
    """

    def __init__(self, traceback: str, is_hosts: bool = False) -> None:
        super().__init__(traceback, is_hosts)
        self.traceback = traceback
        self.is_hosts = is_hosts

    def __str__(self) -> str:
        return self.traceback
