"""What the service refuses.

::

    ServiceError
    ├── SettingsError       a configuration file; names the file and every wrong field
    ├── StoreError          the result store cannot be opened or written; fatal for the daemon
    ├── VolumeModelError    a file of volume coefficients; names the file and the field
    └── UsageError          a command's arguments contradict each other or the files they name

`WorkerFailure` is none of them: nothing was refused, something broke.
"""


class ServiceError(Exception):
    """Root of what the service raises on purpose."""


class SettingsError(ServiceError):
    """The configuration cannot be used."""


class StoreError(ServiceError):
    """The result store cannot be opened, or a write did not become durable."""


class VolumeModelError(ServiceError):
    """Coefficients of the volume's correction cannot be used, or cannot be fitted from what was given."""


class UsageError(ServiceError):
    """The arguments of a command cannot be carried out."""


class WorkerFailure(Exception):  # noqa: N818 - a bug or a broken environment, with its traceback as text
    """A job in a worker process ended with an exception that says nothing about the stone."""
