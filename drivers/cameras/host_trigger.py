"""Trigger the cameras from this machine, for rigs without a wire from the light gate.

The camera's trigger delay still does the timing; the host adds its jitter, some milliseconds at worst, and each
is 2.4 mm of fall.
"""

import itertools
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from drivers.gvcp import GVCP_PORT, action_command, local_addresses

BROADCAST = "255.255.255.255"
"""Address of all cameras; the datagram leaves by the interface that its socket is bound to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionKeys:
    """The addressees of a GigE Vision action command: cameras with these keys and a bit of this mask."""

    device_key: int = 1
    group_key: int = 1
    group_mask: int = 1
    targets: tuple[str, ...] = (BROADCAST,)  # or the addresses of cameras, for unicast

    def __post_init__(self) -> None:
        for name in ("device_key", "group_key", "group_mask"):
            if not 0 <= getattr(self, name) <= 0xFFFF_FFFF:
                raise ValueError(f"{name} must have 32 bits, not {getattr(self, name)}")
        if self.group_mask == 0 or not self.targets:
            raise ValueError("group_mask must not be 0, nor targets empty")


class ActionTrigger:
    """Sends an action command when called: one datagram for all cameras or one for each, without acknowledgement.

    The call raises `OSError` when no datagram could be sent, or none out of a configured interface.
    """

    def __init__(self, keys: ActionKeys, interfaces: Sequence[str] = ()) -> None:
        self._keys = keys
        self._interfaces = tuple(interfaces)
        self._request_ids = itertools.cycle(range(1, 0x1_0000))

    def __call__(self) -> None:
        keys = self._keys
        datagram = action_command(
            device_key=keys.device_key,
            group_key=keys.group_key,
            group_mask=keys.group_mask,
            request_id=next(self._request_ids),
        )
        is_sent, is_down, problems = False, False, []
        for source, target in self._routes():
            try:
                _send(datagram, source, target)
                is_sent = True
            except OSError as err:
                is_down |= source in self._interfaces
                problems.append(f"{target}{source and ' out of ' + source}: {err.strerror}")
        if is_down or not is_sent:
            raise OSError(f"no action command to {'; '.join(problems)}")

    def _routes(self) -> Iterator[tuple[str, str]]:
        """Yield address of the sender, empty for any, and of the receiver."""
        for target in self._keys.targets:
            if target == BROADCAST:
                for interface in self._interfaces or local_addresses():
                    yield interface, target
            else:
                yield "", target


def _send(datagram: bytes, source: str, target: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.bind((source, 0))
        sender.sendto(datagram, (target, GVCP_PORT))


class SoftwareTrigger:
    """Executes `TriggerSoftware` of all cameras when called, each on a thread of its own: a dead one delays no other.

    A camera that has not yet answered the last command is left out.
    """

    def __init__(self, fire: Sequence[Callable[[], None]]) -> None:
        self._fire = tuple(fire)
        self._threads = [ThreadPoolExecutor(1, f"software trigger {n}") for n in range(len(self._fire))]
        self._calls: list[Future[None] | None] = [None] * len(self._fire)

    def __call__(self) -> None:
        for n, (fire, thread) in enumerate(zip(self._fire, self._threads, strict=True)):
            call = self._calls[n]
            if call is None or call.done():
                # errors are not collected: the frame of the camera is missing, which is noticed
                self._calls[n] = thread.submit(fire)
