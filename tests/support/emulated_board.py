"""The gate's board, emulated cycle by cycle: the firmware's binary in simavr, by `gate_board.c` beside this file."""

import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

from drivers.gates.gate_protocol import LineSplitter, decode
from drivers.gates.gate_records import Record
from drivers.gige_simulator.pseudo_terminal import PseudoTerminal

ROOT = Path(__file__).parents[2]
HZ: Final = 16_000_000
US: Final = 16
MS: Final = 16_000
BYTE_CYCLES: Final = 1500
"""What a byte takes on the line, in simavr a little longer than at 115200 baud."""
ORDERS = 500
"""Orders that fit into a pipe, so that neither end waits for the other."""
LOOK_S = 0.005


@dataclass(frozen=True)
class Build:
    """The firmware as it is flashed, and the program that runs it."""

    firmware: Path
    program: Path

    @classmethod
    def make(cls, folder: Path) -> Self:
        """Compile both into a folder; fails without Debian's gcc-avr, avr-libc and libsimavr-dev."""
        source, program = Path(__file__).with_name("gate_board.c"), folder / "gate_board"
        subprocess.run(
            ["make", "-s", "-C", ROOT / "drivers/gates/firmware", f"BUILD={folder}"], check=True, timeout=120
        )
        subprocess.run(
            ["gcc", "-O2", "-Wall", "-Wextra", "-Werror", "-o", program, source, "-lsimavr"],
            check=True,
            timeout=120,
        )
        return cls(folder / "gate.elf", program)

    def address(self, name: str) -> int:
        """Return where a variable lies in the board's memory."""
        table = subprocess.run(
            ["avr-nm", self.firmware], check=True, timeout=60, capture_output=True, text=True
        )
        (found,) = (line.split()[0] for line in table.stdout.splitlines() if line.split()[-1] == name)
        return int(found, 16) - 0x800000


@dataclass
class Board:
    """A board under power; emulated time passes in `run` alone, as fast as the processor can."""

    build: Build
    now: int = 0  # cycles since power-on
    received: list[tuple[int, bytes]] = field(default_factory=list)
    """Bytes that it sent to the host, with the cycle."""
    levels: list[tuple[int, str, int]] = field(default_factory=list)
    """Cycle, name and new level of each pin that changed."""
    eeprom: bytes = b""

    def __post_init__(self) -> None:
        self._process = subprocess.Popen(
            [self.build.program, self.build.firmware],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1 << 16,
        )
        self._orders: list[tuple[int, str]] = []

    def order(self, name: str, at: int, *arguments: object) -> None:
        """Plan what `gate_board.c` calls an order, in any sequence."""
        self._orders.append((at, " ".join(map(str, [name, at, *arguments]))))

    def stone(self, at: int, width: int = 3 * MS) -> None:
        """Plan a stone that closes the beam at a cycle, for `width` cycles."""
        self.order("beam", at, 1)
        self.order("beam", at + width, 0)

    def hear(self, data: bytes, at: int) -> None:
        """Plan bytes from the host, one after the other."""
        for number, byte in enumerate(data):
            self.order("receive", at + number * BYTE_CYCLES, f"{byte:02x}")

    def run(self, until: int) -> None:
        """Let time pass; what is planned for later is kept."""
        due = sorted((each for each in self._orders if each[0] < until), key=lambda each: each[0])
        self._orders = [each for each in self._orders if each[0] >= until]
        while due:
            self._obey([text for _, text in due[:ORDERS]], due[ORDERS - 1][0] if len(due) > ORDERS else until)
            due = due[ORDERS:]
        self._obey([], until)

    def _obey(self, orders: list[str], until: int) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("".join(f"{text}\n" for text in [*orders, f"run {until}"]))
        self._process.stdin.flush()
        for line in self._process.stdout:
            match line.split():
                case ["sent", cycle, data]:
                    self.received.append((int(cycle), bytes.fromhex(data)))
                case ["pin", cycle, name, level]:
                    self.levels.append((int(cycle), name, int(level)))
                case ["ran", cycle, data]:
                    self.now, self.eeprom = int(cycle), bytes.fromhex(data)
                    return
        raise AssertionError("the firmware crashed")

    def records(self) -> list[Record]:
        """Return all that it told; each line must be whole."""
        lines = LineSplitter().feed(b"".join(data for _, data in self.received))
        return [decode(line.text) for line in lines]

    def rises(self, pin: str) -> list[int]:
        """Return the cycles at which a pin went high."""
        return [cycle for cycle, name, level in self.levels if (name, level) == (pin, 1)]

    def widths(self, pin: str) -> list[int]:
        """Return for how many cycles a pin was high, each time that is over."""
        edges = [cycle for cycle, name, _ in self.levels if name == pin]
        return [end - start for start, end in zip(edges[::2], edges[1::2], strict=False)]

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(60)
        self._process.stdout.close()


class BoardOnPort:
    """A board on a pseudo-terminal, for the driver: emulated time follows the host's.

    `pulse` is the cameras' trigger line: called with the host's time (monotonic ns) of each pulse.
    """

    def __init__(self, board: Board, link: Path, *, pulse: Callable[[int], None] = lambda _: None) -> None:
        self._board = board
        self._port = PseudoTerminal(link)
        self._pulse = pulse
        self._plans: list[Callable[[int], None]] = []
        self._guard = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="board on a port")
        self._start_ns = 0
        self.is_opened = False
        """Whether a host has the port open."""

    def open(self) -> None:
        self._port.plug()
        self._start_ns = time.monotonic_ns() - self._board.now * 1000 // US
        self._thread.start()

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        self._port.unplug()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def soon(self, plan: Callable[[int], None]) -> None:
        """Let `plan` give the board its orders, from the cycle that it is called with on."""
        with self._guard:
            self._plans.append(plan)

    def interrupt(self, edge_ns: int, width_ns: int) -> None:
        """Let a stone close the beam at `edge_ns` of the host, which is now, as a belt does."""
        at = self._cycle(edge_ns)
        self.soon(lambda _: self._board.stone(at, width_ns * US // 1000))

    def _cycle(self, host_ns: int) -> int:
        return (host_ns - self._start_ns) * US // 1000

    def _run(self) -> None:
        board, n_sent, n_pulses = self._board, 0, 0
        while not self._stopping.wait(LOOK_S):
            with self._guard:
                plans, self._plans = self._plans, []
            for plan in plans:
                plan(board.now)
            board.hear(self._port.read(), board.now)
            board.run(self._cycle(time.monotonic_ns()))
            self._port.write(b"".join(data for _, data in board.received[n_sent:]))
            n_sent = len(board.received)
            pulses = board.rises("trigger")
            for cycle in pulses[n_pulses:]:
                self._pulse(self._start_ns + cycle * 1000 // US)
            n_pulses = len(pulses)
            self.is_opened = self._port.is_opened


@contextmanager
def running(build: Build) -> Iterator[Board]:
    """Power a board; it ends with the context."""
    board = Board(build)
    try:
        yield board
    finally:
        board.close()
