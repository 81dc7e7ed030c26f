"""`[mqtt]` of the bridge's configuration: the broker, and what is published there."""

import ssl
from dataclasses import dataclass

from drivers.files.bounded import read_bounded
from service.base.addresses import is_host
from service.base.paths import ConfiguredPath
from service.base.schema import require_ranges

MAX_PASSWORD_BYTES = 1000
MAX_NAME_BYTES = 200
FORBIDDEN = frozenset("#+\0")
"""Characters that mean something else in a topic: wildcards, and what ends a text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SparkplugSettings:
    """Place of the rig in a Sparkplug infrastructure: its topics are `spBv1.0/GROUP/.../NODE/DEVICE`."""

    group: str = "stonefall"
    node: str = "bridge"
    device: str = "rig"
    primary_host: str | None = None  # id of the host application that is waited for; None: none is

    def __post_init__(self) -> None:
        for name in ("group", "node", "device", "primary_host"):
            value = getattr(self, name)
            if value is not None and (problem := _level_problem(value)):
                raise ValueError(f"sparkplug.{name} {problem}")


@dataclass(frozen=True, slots=True, kw_only=True)
class MqttSettings:
    """The broker, and what is published there: plain JSON below `prefix`, Sparkplug B, or both."""

    host: str
    port: int | None = None  # 8883 with TLS, 1883 without
    tls: bool = True  # false: everyone on the way can read and forge, the password too
    ca_file: ConfiguredPath | None = None  # instead of the system's certificates
    certificate_file: ConfiguredPath | None = None  # our own, with key_file, where the broker asks for one
    key_file: ConfiguredPath | None = None
    user: str | None = None
    password_file: ConfiguredPath | None = None  # read for each connection
    client_id: str = "stonefall"  # of the JSON topics; that of Sparkplug ends with -sparkplug
    prefix: str | None = None  # of the JSON topics, such as stonefall/line-1
    waits_for_subscriber: bool = (
        True  # false: JSON results go on though nothing subscribes to them, and are lost
    )
    sparkplug: SparkplugSettings | None = None

    def __post_init__(self) -> None:
        if not is_host(self.host):
            raise ValueError(f"host must be a name or an address without a port, not {self.host!r}")
        require_ranges(self, **({} if self.port is None else {"port": (1, 65535)}))
        if self.prefix is None and self.sparkplug is None:
            raise ValueError(
                "needs a prefix of its JSON topics, such as stonefall/line-1, or a table [mqtt.sparkplug]"
            )
        if self.prefix is not None:
            if any(map(_level_problem, self.prefix.split("/"))) or self.prefix.startswith("$"):
                raise ValueError(f"prefix must be levels such as stonefall/line-1, not {self.prefix!r}")
            if len(self.prefix.encode()) > MAX_NAME_BYTES:
                raise ValueError(f"prefix has more than {MAX_NAME_BYTES} bytes")
        if problem := _level_problem(self.client_id):
            raise ValueError(f"client_id {problem}")
        if not self.tls and (self.ca_file or self.certificate_file or self.key_file):
            raise ValueError("tls is false, so there is no use for ca_file, certificate_file and key_file")
        if (self.certificate_file is None) != (self.key_file is None):
            raise ValueError("certificate_file and key_file: each needs the other")
        if self.password_file is not None and self.user is None:
            raise ValueError("password_file needs a user")

    @property
    def tcp_port(self) -> int:
        """TCP port of the broker."""
        return self.port or (8883 if self.tls else 1883)

    def password(self) -> str | None:
        """Read the password; raise `ValueError`, which names the file."""
        if self.password_file is None:
            return None
        try:
            return read_bounded(self.password_file, MAX_PASSWORD_BYTES).decode().rstrip("\r\n")
        except OSError as err:
            raise ValueError(f"password_file: {self.password_file}: {err.strerror}") from err
        except UnicodeError:
            raise ValueError(f"password_file: {self.password_file}: is not text") from None

    def tls_context(self) -> ssl.SSLContext | None:
        """Read the certificates; the context checks the broker's name. Raise `ValueError`, which names the file."""
        if not self.tls:
            return None
        try:
            context = ssl.create_default_context(cafile=self.ca_file)
        except OSError as err:  # of TLS as well
            raise ValueError(f"ca_file: {self.ca_file}: {err.strerror or err}") from err
        if self.certificate_file is not None:
            try:
                context.load_cert_chain(self.certificate_file, self.key_file, password=_no_passphrase)
            except (OSError, ValueError) as err:
                raise ValueError(f"certificate_file, key_file: {self.certificate_file}: {err}") from err
        return context


def _no_passphrase() -> str:
    raise ValueError("its key has a passphrase, which a service cannot be asked for")


def _level_problem(text: str) -> str | None:
    """Return the reason that forbids a text as level of a topic, None if there is none."""
    if not text or FORBIDDEN & set(text) or "/" in text or not text.isprintable():
        return f"must be text without / # + and control characters, not {text!r}"
    if len(text.encode(errors="replace")) > MAX_NAME_BYTES:
        return f"has more than {MAX_NAME_BYTES} bytes"
    return None
