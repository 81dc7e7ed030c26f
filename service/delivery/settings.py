"""`[webhooks]` and `[file_drop]` of the configuration: endpoints, their events, the folder for files of closed lots."""

import base64
import binascii
import errno
import re
import ssl
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from ipaddress import ip_network
from tempfile import TemporaryFile
from urllib.parse import SplitResult, urlsplit

from pydantic import SecretStr

from drivers.files.bounded import read_bounded
from service.base.addresses import address_of, is_host
from service.base.ids import ID
from service.base.language import Language
from service.base.paths import ConfiguredPath
from service.base.redaction import shown
from service.base.schema import require_ranges
from service.store.events import EventType

PRIVATE_NETWORKS = ("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "fc00::/7")
PORTS = {"http": 80, "https": 443}
MAX_URL = 2000
MAX_ENDPOINTS = 16
MAX_SECRETS = 2
MAX_SECRET_BYTES = 1000
PREFIX = "whsec_"
KEY_BYTES = range(24, 65)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class WebhookEndpoint:
    """An endpoint and its events; requests are signed with each of the secrets."""

    name: str
    url: str
    secrets: tuple[SecretStr, ...] = ()  # whsec_...; two during a rotation
    secret_files: tuple[ConfiguredPath, ...] = ()  # of one secret each, read for every request
    events: tuple[EventType, ...] = tuple(EventType)
    ca_file: ConfiguredPath | None = None  # instead of the system's certificates

    def __post_init__(self) -> None:
        if not re.fullmatch(ID, self.name):
            raise ValueError(f"name is 1 to 64 letters, digits, dots and dashes, not {self.name!r}")
        if (problem := _url_problem(self.url)) is not None:
            raise ValueError(f"{self.name}: url {problem}")
        if not 1 <= len(self.secrets) + len(self.secret_files) <= MAX_SECRETS:
            raise ValueError(f"{self.name}: secrets and secret_files: one is needed, two during a rotation")
        for secret in self.secrets:
            try:
                key_of(secret.get_secret_value())
            except ValueError as err:
                raise ValueError(f"{self.name}: secrets: {err}") from None
        if not self.events:
            raise ValueError(f"{self.name}: events names no event")

    @property
    def target(self) -> SplitResult:
        """The parts of `url`."""
        return urlsplit(self.url)

    @property
    def host(self) -> str:
        """Name or address of the host."""
        return _canonical(self.target.hostname or "")

    @property
    def port(self) -> int:
        """TCP port."""
        return self.target.port or PORTS[self.target.scheme]

    @property
    def shown_url(self) -> str:
        """The URL without what may be secret: scheme, host and first part of the path."""
        return shown(self.target._replace(query="").geturl())

    def keys(self) -> list[bytes]:
        """Return the keys to sign with; reads files. Raises `ValueError`, which names the file."""
        keys = [key_of(secret.get_secret_value()) for secret in self.secrets]
        for path in self.secret_files:
            try:
                keys.append(key_of(read_bounded(path, MAX_SECRET_BYTES).decode("ascii").strip()))
            except OSError as err:
                raise ValueError(f"secret_files: {path}: {err.strerror}") from err
            except ValueError as err:
                reason = "is not text" if isinstance(err, UnicodeError) else str(err)
                raise ValueError(f"secret_files: {path}: {reason}") from None
        return keys

    def tls(self) -> ssl.SSLContext | None:
        """Return the TLS context, None for http; reads files. Raises `ValueError`, which names the file."""
        if self.target.scheme != "https":
            return None
        try:
            return ssl.create_default_context(cafile=self.ca_file)
        except OSError as err:  # of TLS as well
            raise ValueError(f"ca_file: {self.ca_file}: {err.strerror or err}") from err


@dataclass(frozen=True, slots=True, kw_only=True)
class WebhooksSettings:
    """Hosts that events may be posted to, and the endpoints on them."""

    allowed_hosts: tuple[str, ...] = ()  # names and addresses, without a port
    allowed_networks: tuple[str, ...] = PRIVATE_NETWORKS  # which names may lead to
    timeout_s: float = 15.0
    endpoints: tuple[WebhookEndpoint, ...] = ()

    def __post_init__(self) -> None:
        for host in self.allowed_hosts:
            if not is_host(host):
                raise ValueError(f"allowed_hosts: must be names or addresses without a port, not {host!r}")
        for network in self.allowed_networks:
            try:
                ip_network(network)
            except ValueError as err:
                raise ValueError(f"allowed_networks: {err}") from None
        require_ranges(self, timeout_s=(0.1, 60))
        if len(self.endpoints) > MAX_ENDPOINTS:
            raise ValueError(f"endpoints: {MAX_ENDPOINTS} at most, not {len(self.endpoints)}")
        names = [endpoint.name for endpoint in self.endpoints]
        if len(set(names)) < len(names):
            raise ValueError("endpoints: each needs a name of its own")
        for endpoint in self.endpoints:
            if not self.allows_host(endpoint.host):
                raise ValueError(
                    f"endpoints: {endpoint.name}: its host {endpoint.host} is not in allowed_hosts"
                )

    def allows_host(self, host: str) -> bool:
        """True when a host of a URL is among the plant's allowed hosts."""
        return _canonical(host) in map(_canonical, self.allowed_hosts)

    def allows_address(self, host: str, address: str) -> bool:
        """True when connecting to the host at this address, to which its name was resolved, is allowed."""
        found = address_of(address)
        if address_of(host) is not None:
            return found == address_of(host) and self.allows_host(host)
        return found is not None and any(found in ip_network(network) for network in self.allowed_networks)


class DropFormat(StrEnum):
    """Format of the files of a lot, and their suffix."""

    CSV = "csv"
    XLSX = "xlsx"
    PDF = "pdf"
    JSON = "json"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileDropSettings:
    """The folder for files of closed lots."""

    dir: ConfiguredPath
    formats: tuple[DropFormat, ...] = (DropFormat.CSV,)
    language: Language | None = None  # of PDF and workbook; that of issued reports when absent
    shift_sheets: bool = False  # also the sheet of each shift, as PDF
    must_be_mounted: bool = False  # nothing is written while no file system is mounted at `dir`

    def __post_init__(self) -> None:
        if not self.formats:
            raise ValueError("formats names no format")

    def require_present(self) -> None:
        """Raise `OSError` if the folder is not there, or is not what is to be mounted there; blocks."""
        if not self.dir.is_dir():
            raise FileNotFoundError(errno.ENOENT, "there is no such folder")
        if self.must_be_mounted and not self.dir.is_mount():
            raise FileNotFoundError(errno.ENOENT, "nothing is mounted there")

    def problem(self) -> str | None:
        """Return the reason why no file can be written now, None when one can; blocks."""
        try:
            self.require_present()
            with TemporaryFile(dir=self.dir):
                return None
        except OSError as err:
            return f"{self.dir}: {err.strerror}"


def delivery_shortcomings(webhooks: WebhooksSettings, file_drop: FileDropSettings | None) -> Iterator[str]:
    """Yield the present obstacles to webhooks and file drop, each with its field; reads files."""
    for endpoint in webhooks.endpoints:
        for read in (endpoint.keys, endpoint.tls):
            try:
                read()
            except ValueError as err:
                yield f"webhooks.endpoints: {endpoint.name}: {err}"
    if file_drop is not None and (problem := file_drop.problem()) is not None:
        yield f"file_drop.dir: {problem}"


def _url_problem(url: str) -> str | None:
    if len(url) > MAX_URL or not url.isascii() or not url.isprintable() or " " in url:
        return f"must be printable ASCII without spaces, {MAX_URL} characters at most"
    try:
        parts = urlsplit(url)
        host = parts.hostname
        _ = parts.port
    except ValueError as err:
        return f"is not valid: {err}"
    if parts.scheme not in PORTS:
        return "must begin with http:// or https://"
    if host is None or not is_host(host) or "%" in parts.netloc or parts.port == 0:
        return "names no host, or no port of it"
    if parts.username is not None or parts.password is not None or parts.fragment:
        return "must have no user, password or fragment"
    return None


def _canonical(host: str) -> str:
    """Return a host in the one form in which it is compared."""
    address = address_of(host)
    return host.lower().removesuffix(".") if address is None else str(address)
