"""The sockets and the thread of a camera's control channel, with the faults of its network.

One socket is bound to the camera's address, one receives broadcasts; answers always leave from the first.
"""

import os
import random
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from drivers.gige_simulator.faults import Faults
from drivers.gige_simulator.gvcp_channel import Peer, is_discovery, pending_ack
from drivers.gvcp import GVCP_PORT

_PENDING_FROM_MS = 100.0
"""An acknowledgement that is delayed by so much or more is announced by a pending one."""


class GvcpPort:
    """Passes datagrams to `answer` and sends what it returns; calls `run_due` at `next_due_ns` (monotonic clock)."""

    def __init__(
        self,
        name: str,
        *,
        answer: Callable[[bytes, Peer], bytes | None],
        next_due_ns: Callable[[], int | None],
        run_due: Callable[[], None],
        faults: Faults,
        seed: int,
    ) -> None:
        self._name = name
        self._answer = answer
        self._next_due_ns = next_due_ns
        self._run_due = run_due
        self._faults = faults
        self._random = random.Random(f"{seed}/control")  # noqa: S311 - repeatable, nothing secret
        self._lock = threading.Lock()
        self._sockets: tuple[socket.socket, ...] = ()
        self._retired: list[socket.socket] = []  # to be closed by the thread that reads them
        self._wake: int | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def is_open(self) -> bool:
        return self._thread is not None

    def open(self, address: str) -> None:
        """Start to answer at an address; raises `OSError` when it is taken or not this machine's."""
        self._stopping.clear()
        self._sockets = _bound(address)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)
        self._thread = threading.Thread(target=self._serve, name=f"{self._name} control", daemon=True)
        self._thread.start()

    def move(self, address: str) -> None:
        """Answer at another address instead; raises `OSError` when it is taken or not this machine's."""
        sockets = _bound(address)
        with self._lock:
            self._retired += self._sockets
            self._sockets = sockets
        self.wake()

    def wake(self) -> None:
        """Make the thread call `next_due_ns` again and look for changed sockets."""
        with self._lock:
            if self._wake is not None:
                os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        self._stopping.set()
        self.wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._lock:
            for udp_socket in (*self._retired, *self._sockets):
                udp_socket.close()
            self._retired, self._sockets = [], ()
            if self._wake is not None:
                os.close(self._wake)
                self._wake = None

    def _serve(self) -> None:
        while not self._stopping.is_set():
            poll, by_fd = self._listening()
            due_ns = self._next_due_ns()
            timeout_ms = None if due_ns is None else max(0, (due_ns - time.monotonic_ns()) // 1_000_000 + 1)
            for fd, _ in poll.poll(timeout_ms):
                if from_socket := by_fd.get(fd):
                    self._receive(from_socket)
                else:
                    os.eventfd_read(fd)
            if not poll.poll(0):  # a datagram that arrived in time counts, even when it is read late
                self._run_due()

    def _listening(self) -> tuple[select.poll, dict[int, socket.socket]]:
        with self._lock:
            while self._retired:
                self._retired.pop().close()
            by_fd = {udp_socket.fileno(): udp_socket for udp_socket in self._sockets}
            poll = select.poll()
            for fd in (*by_fd, self._wake):
                if fd is not None:
                    poll.register(fd, select.POLLIN)
            return poll, by_fd

    def _receive(self, from_socket: socket.socket) -> None:
        try:
            datagram, peer = from_socket.recvfrom(2048)
        except OSError:  # an ICMP error for an answer to a socket that was closed meanwhile
            return
        if self._loses():
            return
        delay_ms = 0.0 if is_discovery(datagram) else self._faults.ack_delay_ms
        if delay_ms >= _PENDING_FROM_MS:
            self._send(pending_ack(datagram, round(delay_ms * 2)), peer)
        if delay_ms > 0:
            self._stopping.wait(delay_ms / 1000)
        answer = self._answer(datagram, peer)
        if answer is not None and not self._loses():
            self._send(answer, peer)

    def _send(self, answer: bytes | None, peer: Peer) -> None:
        if answer is not None:
            with suppress(OSError):
                self._sockets[0].sendto(answer, peer)

    def _loses(self) -> bool:
        return self._faults.control_loss > 0 and self._random.random() < self._faults.control_loss


def _bound(address: str) -> tuple[socket.socket, ...]:
    """Return the socket of an address, and the one that receives broadcasts."""
    control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    broadcast = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        control.bind((address, GVCP_PORT))
        broadcast.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        broadcast.bind(("255.255.255.255", GVCP_PORT))
    except OSError:
        control.close()
        broadcast.close()
        raise
    return control, broadcast
