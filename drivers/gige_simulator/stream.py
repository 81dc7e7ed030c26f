"""The stream channel of a simulated camera: sends packets at the pace of the link, keeps frames for resends."""

import random
import socket
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

from drivers.gige_simulator.counters import WireTally
from drivers.gige_simulator.faults import Faults
from drivers.gige_simulator.gvsp import ETHERNET_BYTES, IP_UDP_BYTES, Packet, unavailable
from drivers.gige_simulator.registers import AckStatus
from drivers.gige_simulator.uplink import Uplink

N_KEPT = 3
"""How many frames a camera keeps for resends."""
BURST_S = 0.001
"""The sender sleeps so long, then sends what would have left meanwhile: shorter costs more processor time."""
_SEND_BUFFER_BYTES = 2 << 20


@dataclass(slots=True)
class _Kept:
    """A frame that is kept for resends."""

    packets: Sequence[Packet]
    missing: set[int] = field(default_factory=set)  # packets that should have left and did not
    is_sent: bool = False  # every packet was sent or dropped
    is_whole: bool = False


class StreamChannel:
    """Sends to one destination; thread-safe, as frames are sent by one thread and resends by another."""

    def __init__(
        self,
        faults: Faults,
        *,
        seed: int,
        is_connected: Callable[[], bool],
        uplink: Uplink | None = None,
    ) -> None:
        self.tally = WireTally()
        self._faults = faults
        self._is_connected = is_connected
        self._uplink = uplink
        self._send_random = random.Random(f"{seed}/send")  # noqa: S311 - repeatable, nothing secret
        self._resend_random = random.Random(f"{seed}/resend")  # noqa: S311 - as above
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, _Kept] = OrderedDict()
        self._socket: socket.socket | None = None
        self._destination: tuple[str, int] | None = None
        self._link_free_s = 0.0  # when the latest frame has left, at the pace of the link

    def open(self, address: str) -> int:
        """Bind to the camera's address and return the port that packets are sent from; raises `OSError`."""
        stream_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stream_socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        try:
            stream_socket.bind((address, 0))
        except OSError:
            stream_socket.close()
            raise
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            self._socket = stream_socket
        return int(stream_socket.getsockname()[1])

    def close(self) -> None:
        self.disconnect()
        with self._lock:
            if self._socket is not None:
                self._socket.close()
                self._socket = None

    def connect(self, address: str, port: int) -> None:
        """Set the destination; frames kept for the last one are dropped."""
        with self._lock:
            self._destination = (address, port)
            self._kept.clear()

    def disconnect(self) -> None:
        with self._lock:
            self._destination = None
            self._kept.clear()

    def send(
        self,
        block_id: int,
        frame: Sequence[Packet],
        *,
        due_s: float,
        rate_bytes_s: float,
        gap_ns: int,
        is_wanted: Callable[[], bool],
    ) -> None:
        """Send a frame at `rate_bytes_s` with `gap_ns` between packets; returns when it is sent or not `is_wanted`.

        To the uplink it leaves from `due_s` on, or once the frame before it has left, however late this thread is.
        """
        kept = _Kept(frame)
        with self._lock:
            self._kept[block_id] = kept
            while len(self._kept) > N_KEPT:
                self._kept.popitem(last=False)
        packet_s = (len(frame[1]) + IP_UDP_BYTES) / rate_bytes_s + gap_ns / 1e9
        leaves_s = max(due_s, self._link_free_s)
        self._link_free_s = leaves_s + len(frame) * packet_s
        is_sent = self._send_all(kept, leaves_s, packet_s, is_wanted)
        with self._lock:
            self.tally.torn += 1
            kept.is_sent = is_sent
            self._settle(kept)

    def _send_all(self, kept: _Kept, leaves_s: float, packet_s: float, is_wanted: Callable[[], bool]) -> bool:
        """Send a packet every `packet_s`; returns False, early, when the frame is no longer wanted."""
        n_burst = max(1, int(BURST_S / packet_s))
        order = _order(len(kept.packets), reorder=self._faults.reorder)
        start_s = time.monotonic()
        for first in range(0, len(order), n_burst):
            burst = order[first : first + n_burst]
            ahead_s = start_s + (first + len(burst)) * packet_s - time.monotonic()
            if ahead_s > 0:
                time.sleep(ahead_s)
            if not is_wanted():
                return False
            with self._lock:
                self._put_burst(kept, burst, leaves_s + first * packet_s, packet_s)
        return True

    def _put_burst(self, kept: _Kept, packet_ids: Sequence[int], leaves_s: float, packet_s: float) -> None:
        faults, frame = self._faults, kept.packets
        if self._is_plain() and self._socket is not None and self._destination is not None:
            send, destination = self._socket.sendto, self._destination
            with suppress(OSError):
                for packet_id in packet_ids:
                    send(frame[packet_id], destination)
            self.tally.packets += len(packet_ids)
            return
        lost = {packet_id % len(frame) for packet_id in faults.lost_packets if packet_id < len(frame)}
        for n_before, packet_id in enumerate(packet_ids):
            at_s = leaves_s + n_before * packet_s
            is_lost = (
                packet_id in lost
                or (faults.stall_after is not None and packet_id > faults.stall_after)
                or _strikes(self._send_random, faults.packet_loss)
            )
            if not self._put(frame[packet_id], at_s, is_lost=is_lost):
                kept.missing.add(packet_id)
            elif _strikes(self._send_random, faults.duplicate):
                self._put(frame[packet_id], at_s, is_lost=False)

    def _is_plain(self) -> bool:
        """Whether no fault can affect a packet: the usual case, in which bursts are cheap."""
        faults = self._faults
        return (
            not (faults.packet_loss or faults.lost_packets or faults.duplicate)
            and faults.stall_after is None
            and self._uplink is None
            and self._is_connected()
        )

    def resend(self, block_id: int, first: int, last: int, *, has_extended_ids: bool) -> None:
        """Send packets `first` to `last` of a kept frame again, or for each the answer that it is unavailable."""
        with self._lock:
            kept = self._kept.get(block_id)
            n_packets = len(kept.packets) if kept else 0
            for packet_id in range(first, min(last, first + 0xFFFF) + 1):
                if kept is None or packet_id >= n_packets or self._faults.no_resend:
                    refusal = unavailable(
                        block_id,
                        packet_id,
                        AckStatus.PACKET_UNAVAILABLE,
                        has_extended_ids=has_extended_ids,
                    )
                    self.tally.unavailable += self._put(refusal, time.monotonic(), is_lost=False)
                    if packet_id >= n_packets:
                        return
                    continue
                is_lost = _strikes(self._resend_random, self._faults.packet_loss)
                if self._put(kept.packets[packet_id], time.monotonic(), is_lost=is_lost):
                    self.tally.resent += 1
                    kept.missing.discard(packet_id)
            if kept is not None:
                self._settle(kept)

    def send_raw(self, datagram: bytes, destination: tuple[str, int] | None = None) -> None:
        """Send a datagram that is not part of a frame, uncounted."""
        with self._lock, suppress(OSError):
            target = destination or self._destination
            if self._socket is not None and target is not None and self._is_connected():
                self._socket.sendto(datagram, target)

    def tallied(self) -> WireTally:
        with self._lock:
            return replace(self.tally)

    def _put(self, packet: Packet, at_s: float, *, is_lost: bool) -> bool:
        """Send a packet, or count it as dropped; returns whether it was sent."""
        if (
            is_lost
            or self._socket is None
            or self._destination is None
            or not self._is_connected()
            or (
                self._uplink is not None
                and not self._uplink.carries(len(packet) + IP_UDP_BYTES + ETHERNET_BYTES, at_s)
            )
        ):
            self.tally.dropped += 1
            return False
        with suppress(OSError):  # the receiver is gone, which a real wire would not report
            self._socket.sendto(packet, self._destination)
        self.tally.packets += 1
        return True

    def _settle(self, kept: _Kept) -> None:
        """Count a frame as whole once its last missing packet has left."""
        if kept.is_sent and not kept.missing and not kept.is_whole:
            kept.is_whole = True
            self.tally.torn -= 1
            self.tally.frames += 1


def _order(n_packets: int, *, reorder: bool) -> list[int]:
    order = list(range(n_packets))
    if reorder:
        for i in range(2, n_packets - 2, 7):
            order[i], order[i + 1] = order[i + 1], order[i]
    return order


def _strikes(generator: random.Random, probability: float) -> bool:
    return probability > 0 and generator.random() < probability
