"""The errors that drivers raise, and the faults that devices tell of.

::

    DriverError
    ├── RecordingError             a recording, bundle, rig or image file; names the file and the problem
    └── DeviceError                names the device, the problem and its cause
        ├── CameraUnavailableError
        └── GateUnavailableError
"""

from enum import StrEnum
from pathlib import Path
from typing import Any


class LossCause(StrEnum):
    """Why a device cannot be used, for code that decides by it; the text beside it is for people."""

    SILENT = "silent"
    """It does not answer: no power, no cable, no switch, or the port of this machine is down."""
    WRONG_CAMERA = "wrong_camera"
    """Another camera answers at its address, or several match its settings."""
    IN_USE = "in_use"
    """Another application has control of it."""
    CONTROL_LOST = "control_lost"
    """It no longer knows this process: it was restarted, or its heartbeat ended."""
    WRONG_SETTINGS = "wrong_settings"
    """It is not set as configured, or cannot be."""
    PROCESS_ENDED = "process_ended"
    """The process that the cameras' library runs in has died, and with it the control of all cameras."""
    OTHER = "other"


class DeviceFault(StrEnum):
    """Kinds of faults by which a text of a driver is worded in other languages; `words` are the English ones.

    `reported` is a text of foreign origin, such as the operating system's; figures have their unit in the name.
    """

    words: str

    def __new__(cls, code: str, words: str) -> "DeviceFault":
        """Return the member of a code."""
        made = str.__new__(cls, code)
        made._value_, made.words = code, words
        return made

    BEAM_CLOSED = (
        "beam_closed",
        "the beam has been closed for {closed_s:.0f} s: remove what blocks it, clean and align sensor and light",
    )
    GATE_LINES_LATE = (
        "gate_lines_late",
        "{lines} lines within the last minute came up to {late_ms:.0f} ms late ({since_start} since the start): look"
        " at the load of this machine, and at the latency of the serial converter",
    )
    GATE_RESTARTED = (
        "gate_restarted",
        "was restarted within the last minute, and counts anew: stones that it had not announced may be unknown: "
        "check its power supply",
    )
    GATE_PORT_MISSING = (
        "gate_port_missing",
        "there is no such port: plug the gate in, and name it as under /dev/serial/by-id/",
    )
    GATE_CLOCK_SHORT = (
        "gate_clock_short",
        "its clock has 32 bits and wrapped to 0, as it does every 71.6 minutes: it was counted on; let its firmware"
        " send 64 bits, as the protocol asks, so that a wrap is never taken for a restart",
    )
    GATE_CANNOT_DELAY = (
        "gate_cannot_delay",
        "makes no delay, and {delay_us} us are wanted of it: flash a firmware that can, or let cameras or a timer make"
        " it (rig.delay)",
    )
    GATE_DELAY_REFUSED = (
        "gate_delay_refused",
        "cannot be set to a delay of {delay_us} us with pulses of {pulse_us} us: it stays at {set_us} us with"
        " {set_pulse_us} us; look at the limits of its firmware",
    )
    GATE_DELAY_DIFFERS = (
        "gate_delay_differs",
        "makes a delay of {set_us} us with pulses of {set_pulse_us} us, and not {delay_us} us with {pulse_us} us as it"
        " was set to: look at its power supply",
    )
    GATE_PULSES_UNMADE = (
        "gate_pulses_unmade",
        "did not trigger the cameras {pulses} times within the last minute, as {places} pulses waited: feed more"
        " evenly, or look for what closes the beam besides stones",
    )
    GATE_LINES_UNKNOWN = (
        "gate_lines_unknown",
        "sent {lines} lines with a valid checksum within the last minute that this version does not know, the last one"
        ' "{reported}": they are left out; look at the firmware',
    )
    GATE_FIRMWARE_OLD = (
        "gate_firmware_old",
        "its firmware is version {version}, this release has {current}: write that into it,"
        " make -C drivers/gates/firmware flash",
    )
    GATE_PORT_DENIED = (
        "gate_port_denied",
        "permission denied: the service's user must be in the group {group}, to which the port belongs",
    )
    GATE_PORT_TAKEN = "gate_port_taken", "is in use by another program"
    GATE_PORT_UNUSABLE = "gate_port_unusable", "cannot be opened: {reported}"
    GATE_NO_MODEM_LINES = "gate_no_modem_lines", "has no modem lines"
    GATE_NO_CTS = (
        "gate_no_cts",
        "its port has no CTS (USB CDC shows it always on): wire the sensor to DSR or CD, or take another converter",
    )
    GATE_GPIO_UNUSABLE = (
        "gate_gpio_unusable",
        "cannot be opened: {reported}; the chip must exist, the line be free, and the service's user in the group "
        "dialout",
    )
    GATE_GPIOD_MISSING = "gate_gpiod_missing", "the Python package gpiod is missing, or is 1.x: install 2.x"
    GATE_UNIDENTIFIED = (
        "gate_unidentified",
        "sends no identity and status within {waited_s:g} s ({damaged} damaged lines): check port, cable, power supply"
        " and firmware",
    )
    GATE_NOISE = (
        "gate_noise",
        "sends damaged lines only: {damaged} and no valid one within {waited_s:g} s ({received_bytes} bytes): check"
        " baud rate and parity, then ground and shield of its cable",
    )
    GATE_FOREIGN = (
        "gate_foreign",
        "sends text, but within {waited_s:g} s no line of the protocol that is read here, the last one"
        ' "{reported}": check port and firmware; if it is garbled, cable and shield',
    )
    GATE_MUTE = (
        "gate_mute",
        "has sent nothing for {silent_s:g} s: check its cable and its power supply",
    )
    GATE_GONE = "gate_gone", "is gone: {reported}"
    DEVICE_DISCONNECTED = "device_disconnected", "disconnected"
    RECEIVE_BUFFER_SMALL = (
        "receive_buffer_small",
        "the kernel granted {granted_bytes} of {wanted_bytes} bytes to receive into: "
        "sysctl -w net.core.rmem_max={wanted_bytes}",
    )
    LINK_SLOW = (
        "link_slow",
        "its link runs at {link_mbit_s} Mbit/s: check the cable and the port of the switch",
    )
    CLOCK_WITHOUT_MASTER = (
        "clock_without_master",
        "its clock follows no PTP master (status {status}): is one running?",
    )
    FEATURE_PUT_BACK = "feature_put_back", "{feature} was {before}: put back to {after}"
    FEATURE_STAYS = "feature_stays", "{feature} is {value}, and cannot be put back"
    ENTRY_INSTEAD = "entry_instead", "has no {wanted} in {feature}: {used} is used"


class Told(str):
    """A text of a driver in English, with the fault that it tells of and the parameters of its words."""

    fault: DeviceFault
    parameters: dict[str, str | int | float]

    def __new__(cls, text: str, fault: DeviceFault, parameters: dict[str, str | int | float]) -> "Told":
        """Return the text of a fault; see `told`."""
        made = super().__new__(cls, text)
        made.fault, made.parameters = fault, parameters
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return Told, (str(self), self.fault, self.parameters)

    def after(self, beginning: str) -> "Told":
        """Return the same fault with a text that begins otherwise."""
        return Told(f"{beginning}{self}", self.fault, self.parameters)


def told(fault: DeviceFault, **parameters: str | int | float) -> Told:
    """Return a fault in its English words; raise `KeyError` if they need a parameter that is missing."""
    return Told(fault.words.format(**parameters), fault, parameters)


class DriverError(Exception):
    """Root of the errors that drivers raise on purpose."""


class RecordingError(DriverError):
    """A file is missing, damaged, truncated, foreign or contradicts its recording."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(path, problem)  # the arguments of this class: pickle calls it with them
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.path}: {self.problem}"


class DeviceError(DriverError):
    """A device cannot do what was asked of it."""

    def __init__(self, device: str, problem: str, cause: LossCause = LossCause.OTHER) -> None:
        super().__init__(device, problem, cause)
        self.device = device
        self.problem = problem
        self.cause = cause

    @property
    def told(self) -> str:
        """The whole text, which keeps the fault of the problem."""
        return self.problem.after(f"{self.device}: ") if isinstance(self.problem, Told) else str(self)

    def __str__(self) -> str:
        return f"{self.device}: {self.problem}"


class CameraUnavailableError(DeviceError):
    """The camera does not answer, is not the expected one, is in use, or is not set as configured."""


class GateUnavailableError(DeviceError):
    """The light gate does not answer, or cannot do what was asked of it."""
