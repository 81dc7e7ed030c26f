"""Counts of a gate's lines, and the bytes since the last valid one: nothing, noise, or text of another protocol."""

from dataclasses import dataclass

from drivers.errors import DeviceFault, Told, told

TEXT = frozenset(range(0x20, 0x7F)) | frozenset(b"\t\r\n")
TEXT_SHARE = 0.9
"""Share of printable bytes from which a port receives text; a wrong baud rate leaves a third, a wrong parity half."""
SAMPLE_BYTES = 60


@dataclass(slots=True, kw_only=True)
class GateCounters:
    """Counts of the lines received from the gate since the driver was made, armed or not."""

    lines: int = 0  # valid ones
    garbage: int = 0  # damaged lines, and bytes between lines
    unknown: int = 0  # lines that are whole, and no record of the protocol; among the valid ones
    edges: int = 0  # announced by the gate, without repeated lines
    test_pulses: int = 0
    bounces: int = 0  # edges merged by the host
    ignored: int = 0  # edges merged by the gate
    repeated: int = 0  # lines
    missed: int = 0  # edges counted by the gate and never announced
    restarts: int = 0  # of the gate
    wraps: int = 0  # of a clock of 32 bits
    late: int = 0  # lines
    unmade: int = 0  # pulses to the cameras for which the gate had no place


class Reception:
    """Bytes without a valid line: they distinguish a silent gate from one that cannot be read."""

    def __init__(self) -> None:
        self.begin(0)

    def begin(self, n_damaged: int) -> None:
        """Forget what was received; `n_damaged` damaged lines were counted until now."""
        self._n_bytes = self._n_text = 0
        self._n_damaged = n_damaged
        self._sample = b""

    def note(self, data: bytes) -> None:
        """Note what was read from the port."""
        self._n_bytes += len(data)
        self._n_text += sum(byte in TEXT for byte in data)
        self._sample = (self._sample + data)[-2 * SAMPLE_BYTES :]

    def problem(self, waited_s: float, n_damaged: int) -> Told | None:
        """Return the reason why no line was valid for `waited_s`; None when nothing was received.

        `n_damaged` is the count of damaged lines now.
        """
        if not self._n_bytes:
            return None
        if self._n_text >= TEXT_SHARE * self._n_bytes:
            line = max(self._sample.decode("ascii", "replace").splitlines() or [""], key=len)
            return told(DeviceFault.GATE_FOREIGN, waited_s=waited_s, reported=line[:SAMPLE_BYTES].strip())
        return told(
            DeviceFault.GATE_NOISE,
            waited_s=waited_s,
            received_bytes=self._n_bytes,
            damaged=n_damaged - self._n_damaged,
        )
