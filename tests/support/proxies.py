"""nginx and Caddy in front of a daemon, with the files of deploy/proxy, without privileges and on loopback ports."""

import os
import pwd
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from support.browser import PROXIED as NAME
from support.daemon_process import free_port
from support.eventually import eventually

FILES = Path(__file__).parents[2] / "deploy/proxy"
NGINX = """
user {user};
error_log stderr;
pid {folder}/nginx.pid;
events {{}}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    include {site};
}}
"""
CADDY = """
{{
    admin localhost:{admin_port}
    default_bind 127.0.0.1
    http_port {http_port}
    https_port {https_port}
    storage file_system {folder}
}}
import {site}
"""


@dataclass(frozen=True, slots=True)
class Proxy:
    """A running proxy: its port of TLS, and what `systemctl reload` does."""

    port: int
    reload: Callable[[], None]


@contextmanager
def nginx(folder: Path, daemon_port: int) -> Iterator[Proxy]:
    """Run nginx with our file, in which ports, certificate and daemon are others."""
    http_port, https_port = free_port(), free_port()
    certificate, key = write_certificate(folder)
    site = (FILES / "nginx.conf").read_text()
    for ours, theirs in (
        ("listen 80;", f"listen 127.0.0.1:{http_port};"),
        ("listen 443 ", f"listen 127.0.0.1:{https_port} "),
        ("/etc/ssl/certs/stonefall.pem", str(certificate)),
        ("/etc/ssl/private/stonefall.key", str(key)),
        ("127.0.0.1:8080", f"127.0.0.1:{daemon_port}"),
    ):
        assert site.count(ours) == 1, ours
        site = site.replace(ours, theirs)
    (folder / "stonefall.conf").write_text(site)
    main = folder / "nginx.conf"
    user = pwd.getpwuid(os.geteuid()).pw_name
    main.write_text(NGINX.format(folder=folder, site=folder / "stonefall.conf", user=user))
    command = ["/usr/sbin/nginx", "-e", "stderr", "-c", str(main), "-g"]
    with _running(folder, [*command, "daemon off;"], {}, https_port) as process:
        yield Proxy(https_port, lambda: process.send_signal(signal.SIGHUP))


@contextmanager
def caddy(folder: Path, daemon_port: int) -> Iterator[Proxy]:
    """Run Caddy with our very file, with its variables set."""
    https_port, admin_port = free_port(), free_port()
    certificate, key = write_certificate(folder)
    main = folder / "Caddyfile"
    ports = {"http_port": free_port(), "https_port": https_port, "admin_port": admin_port}
    main.write_text(CADDY.format(folder=folder, site=FILES / "Caddyfile", **ports))
    variables = {
        "STONEFALL_CERTIFICATE": str(certificate),
        "STONEFALL_KEY": str(key),
        "STONEFALL_DAEMON": f"127.0.0.1:{daemon_port}",
        "HOME": str(folder),
    }
    options = ["--config", str(main), "--adapter", "caddyfile"]
    reload = [
        "/usr/bin/caddy",
        "reload",
        *options,
        "--address",
        f"localhost:{admin_port}",
        "--force",
    ]  # Debian's unit
    with _running(folder, ["/usr/bin/caddy", "run", *options], variables, https_port):
        yield Proxy(
            https_port,
            lambda: (
                subprocess.run(reload, env=os.environ | variables, check=True, capture_output=True) and None
            ),
        )


PROXIES: tuple[Callable[..., object], ...] = (nginx, caddy)


@contextmanager
def _running(
    folder: Path, command: list[str], variables: dict[str, str], port: int
) -> Iterator[subprocess.Popen[bytes]]:
    log = folder / "proxy.log"
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output, env=os.environ | variables)
    try:
        eventually(lambda: process.poll() is not None or _listens(port))
        assert process.poll() is None, log.read_text()
        yield process
        assert process.poll() is None, log.read_text()
    finally:
        process.terminate()  # nginx ends its workers
        process.wait()


def _listens(port: int) -> bool:
    with closing(socket.socket()) as attempt:
        return attempt.connect_ex(("127.0.0.1", port)) == 0


def write_certificate(folder: Path) -> tuple[Path, Path]:
    """Write a certificate for `NAME` that signs itself, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, NAME)])
    now = datetime.now(UTC)
    built = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(NAME)]), critical=False)
        .sign(key, hashes.SHA256())
    )
    certificate, private = folder / "stonefall.pem", folder / "stonefall.key"
    certificate.write_bytes(built.public_bytes(serialization.Encoding.PEM))
    private.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
    )
    return certificate, private
