"""The errors of the service.

::

    ServiceError
    ├── SettingsError       a configuration file; names the file and every wrong field
    ├── StoreError          the result store cannot be opened, or a write is wrong; a disk that refuses only holds it
    ├── VolumeModelError    coefficients of the volume correction; names the file and the field
    ├── TooManyError        as many of a thing are stored as there may be
    ├── StandardsError      tables of sieves and specifications; names the file and every wrong field
    └── UsageError          a command's arguments contradict each other or the files they name

`WorkerFailure` is not one of them: it reports a bug or a broken environment.
"""


class ServiceError(Exception):
    """Root of the errors that the service raises on purpose."""


class SettingsError(ServiceError):
    """The configuration cannot be used."""


class StoreError(ServiceError):
    """The result store cannot be opened, or a write did not become durable."""


class TooManyError(ServiceError):
    """As many `things` are stored as there may be; says which of them must go, or what to do instead."""

    def __init__(self, things: str, detail: str) -> None:
        super().__init__(detail)
        self.things = things


class VolumeModelError(ServiceError):
    """Coefficients of the volume correction cannot be read, or cannot be fitted to the given data."""


class StandardsError(ServiceError):
    """The tables of sieves and specifications cannot be used."""


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
