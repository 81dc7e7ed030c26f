"""A real broker on loopback, Debian's mosquitto, and its own subscriber as a foreign client."""

import json
import os
import shutil
import signal
import socket
import subprocess
import threading
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from support.daemon_process import free_port
from support.eventually import eventually

SEARCHED = os.pathsep.join((os.environ.get("PATH", ""), "/usr/sbin"))
MOSQUITTO = shutil.which("mosquitto", path=SEARCHED) or "mosquitto"
MOSQUITTO_SUB = shutil.which("mosquitto_sub", path=SEARCHED) or "mosquitto_sub"
MOSQUITTO_PASSWD = shutil.which("mosquitto_passwd", path=SEARCHED) or "mosquitto_passwd"
MOSQUITTO_PUB = shutil.which("mosquitto_pub", path=SEARCHED) or "mosquitto_pub"
NUMBERS = count(1)
CONFIG = """
per_listener_settings true
persistence true
persistence_location {folder}/
log_dest stderr
log_type all
"""
LISTENER = "listener {port} 127.0.0.1\n{more}\n"
ANYBODY = "allow_anonymous true"


class Mosquitto:
    """Started on entering the context, killed at its end; it may be killed and started in between."""

    def __init__(self, folder: Path, more: str = ANYBODY, *, has_plain: bool = False) -> None:
        """`more`: lines of its listener, such as those of TLS; `has_plain`: with another one, for subscribers."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.port = folder, free_port()
        self.plain_port = free_port() if has_plain else self.port
        self._config, self._log = folder / "mosquitto.conf", folder / "mosquitto.log"
        user = "user root\n" if os.geteuid() == 0 else ""  # else `mosquitto` could not read our files
        listeners = {self.port: more, **({self.plain_port: ANYBODY} if has_plain else {})}
        told = "".join(LISTENER.format(port=port, more=lines) for port, lines in listeners.items())
        self._config.write_text(user + CONFIG.format(folder=folder) + told)
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    @property
    def log(self) -> str:
        return self._log.read_text()

    def start(self) -> None:
        """Start it and return when it listens."""
        with self._log.open("ab") as log:
            self._process = subprocess.Popen([MOSQUITTO, "-c", self._config], stdout=log, stderr=log)
        eventually(self._is_listening)

    def kill(self) -> None:
        """Kill it as a power cut would, but for what it wrote."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def pause(self, *, is_paused: bool) -> None:
        """Have it hang, or go on."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP if is_paused else signal.SIGCONT)

    def _is_listening(self) -> bool:
        assert self._process is not None and self._process.poll() is None, self.log
        with suppress(OSError), closing(socket.create_connection(("127.0.0.1", self.plain_port), 1)):
            return True
        return False


@dataclass(frozen=True)
class Heard:
    topic: str
    payload: bytes
    is_retained: bool

    @property
    def document(self) -> Any:
        return json.loads(self.payload)


class Subscriber:
    """`mosquitto_sub` of some topics; it connects again by itself, with a session that the broker keeps."""

    def __init__(self, broker: Mosquitto, *topics: str, client_id: str | None = None) -> None:
        wanted = [part for topic in topics for part in ("-t", topic)]
        self._broker, self._id = broker, client_id or f"subscriber-{next(NUMBERS)}"
        self._command = [
            MOSQUITTO_SUB,
            "-h",
            "127.0.0.1",
            "-p",
            str(broker.plain_port),
            "-V",
            "mqttv5",
            "-q",
            "1",
        ]
        self._command += ["-i", self._id, "-c", "-x", "3600", "-F", "%r %t %x"]
        self._command += wanted
        self.heard: list[Heard] = []

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        self._reading = threading.Thread(target=self._read, name="mosquitto_sub")
        self._reading.start()
        eventually(lambda: f"Sending SUBACK to {self._id}" in self._broker.log)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        self._reading.join()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def pause(self, *, is_paused: bool) -> None:
        """Have it hang, or go on."""
        self._process.send_signal(signal.SIGSTOP if is_paused else signal.SIGCONT)

    def of(self, topic: str) -> list[Heard]:
        """Return the messages on one topic, in their order."""
        return [each for each in list(self.heard) if each.topic == topic]

    def newest(self, topic: str) -> Any:
        """Return the newest document on one topic, None before the first."""
        found = self.of(topic)
        return found[-1].document if found else None

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            retained, topic, *payload = line.decode().rstrip("\n").split(" ")
            self.heard.append(Heard(topic, bytes.fromhex(payload[0] if payload else ""), retained == "1"))


def publish(port: int, topic: str, payload: bytes, *, is_retained: bool = False) -> None:
    """Publish with `mosquitto_pub`."""
    command = [MOSQUITTO_PUB, "-h", "127.0.0.1", "-p", str(port), "-q", "1", "-t", topic, "-s"]
    subprocess.run([*command, *(["-r"] if is_retained else [])], input=payload, check=True, timeout=60)


def write_passwords(path: Path, **passwords: str) -> None:
    """Write a file of users and their passwords with `mosquitto_passwd`."""
    path.touch()
    for user, password in passwords.items():
        subprocess.run([MOSQUITTO_PASSWD, "-b", path, user, password], check=True, timeout=60)
