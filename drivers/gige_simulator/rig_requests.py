"""Carry out requests to the simulated rig while it runs: faults, power, plugs, the belt.

A request is a JSON object: `do` names the request, a method of `RigRequests`; `of` names a camera by its id, all
`"cameras"` or the `"gate"`; other fields are the arguments of that method. The answer has `"ok": true` and the
result, or `"ok": false` and the `problem`. With `socat - UNIX-CONNECT:PATH`, a request a line::

    {"do": "fault", "of": "c03", "set": {"packet_loss": 0.01}}
    {"do": "fault", "of": "gate", "clear": true, "set": {"bounce": 1}}
    {"do": "unplug", "of": "cameras", "seconds": 2}
    {"do": "power_cycle", "of": "c05", "seconds": 1, "serial": "SIM9999"}
    {"do": "tamper", "of": "c05", "feature": "ExposureTime", "value": 5000}
    {"do": "rate", "hz": 8}
    {"do": "counters"}
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import asdict
from ipaddress import IPv4Address
from typing import Any, Literal, get_args

from drivers.errors import DeviceError
from drivers.gige_simulator.belt import Belt
from drivers.gige_simulator.camera import SimulatedCamera
from drivers.gige_simulator.faults import FaultSwitches
from drivers.gige_simulator.gate import SimulatedGate
from pipeline.frames import CameraId

CAMERAS, GATE = "cameras", "gate"
Malformed = Literal["short", "foreign", "huge", "abort"]

Reply = Mapping[str, Any]


def counters_of(
    cameras: Mapping[CameraId, SimulatedCamera], gate: SimulatedGate, belt: Belt
) -> dict[str, Any]:
    """Return the counters of belt, gate and cameras since the rig was made, as JSON."""
    return {
        "belt": asdict(belt.counters),
        "gate": asdict(gate.counters),
        "cameras": {str(name): asdict(camera.counters) for name, camera in cameras.items()},
    }


class RigRequests:
    """The requests that a rig understands, one method each; `ValueError` says what is wrong with one."""

    def __init__(
        self, *, cameras: Mapping[CameraId, SimulatedCamera], gate: SimulatedGate, belt: Belt
    ) -> None:
        self._cameras = cameras
        self._gate = gate
        self._belt = belt
        self._killed: set[str] = set()
        actions = (
            *(self.help, self.state, self.counters, self.log),
            *(self.fault, self.unplug, self.plug, self.power_cycle, self.kill, self.revive),
            *(self.steal_control, self.tamper, self.jump_clock, self.send_malformed),
            *(self.start, self.stop, self.pulse, self.rate),
        )
        self._actions: dict[str, Callable[..., Reply | None]] = {
            action.__name__: action for action in actions
        }

    def answer(self, request: Mapping[str, Any]) -> Reply:
        """Carry out one request."""
        fields = dict(request)
        name = fields.pop("do", None)
        if name not in self._actions:
            raise ValueError(f"do: must be one of {', '.join(self._actions)}, not {name!r}")
        action = self._actions[name]
        try:
            inspect.signature(action).bind(**fields)
            return action(**fields) or {}
        except TypeError as err:
            raise ValueError(f"{name}: {err}") from err
        except DeviceError as err:
            raise ValueError(str(err)) from err

    # --- to ask ---

    def help(self) -> Reply:
        """List all requests with their fields and what they do."""
        return {
            name: {"takes": list(inspect.signature(action).parameters), "does": inspect.getdoc(action)}
            for name, action in self._actions.items()
        }

    def state(self) -> Reply:
        """Report the state of belt, gate and cameras, and all their faults."""
        return {
            "belt": {
                "is_running": self._belt.is_running,
                "rate_hz": self._belt.rate_hz,
                "has_ended": self._belt.ended.is_set(),
            },
            "gate": {"is_opened": self._gate.is_opened, "faults": self._gate.faults.as_dict()},
            "cameras": {
                name: {
                    "serial": camera.design.serial,
                    "address": camera.design.address,
                    "is_killed": name in self._killed,
                    "is_acquiring": camera.is_acquiring,
                    "is_lit": camera.is_lit,
                    "controller": camera.controller,
                    "faults": camera.faults.as_dict(),
                }
                for name, camera in self._cameras.items()
            },
        }

    def counters(self) -> Reply:
        """Report the counters of belt, gate and cameras."""
        return counters_of(self._cameras, self._gate, self._belt)

    def log(self, of: str) -> Reply:
        """Report the log of each camera, as [monotonic ns, event]."""
        return {name: [[entry.at_ns, entry.event] for entry in camera.log] for name, camera in self._of(of)}

    # --- to break ---

    def fault(self, of: str, set: Mapping[str, Any] | None = None, clear: bool = False) -> Reply:
        """Set faults by name, after clearing all if `clear`; `state` lists those of cameras and gate."""
        if not isinstance(set, Mapping | None):
            raise ValueError(f"set: must be an object with faults by name, not {set!r}")
        devices: list[tuple[str, FaultSwitches]]
        if of == GATE:
            devices = [(GATE, self._gate.faults)]
        else:
            devices = [(name, camera.faults) for name, camera in self._of(of, alive=False)]
        for _, faults in devices:
            if clear:
                faults.clear()
            for fault, value in (set or {}).items():
                faults.set(fault, value)
        return {"faults": {name: faults.as_dict() for name, faults in devices}}

    def unplug(self, of: str, seconds: float | None = None) -> None:
        """Pull the network or serial plug, for `seconds` or until `plug`."""
        if seconds is not None:
            _require_positive("seconds", seconds)
        if of == GATE:
            self._gate.unplug(seconds)
            return
        for _, camera in self._of(of):
            camera.unplug(seconds)

    def plug(self, of: str) -> None:
        """Put the plug in again."""
        if of == GATE:
            self._gate.plug()
            return
        for _, camera in self._of(of):
            camera.replug()

    def power_cycle(
        self, of: str, seconds: float = 2.0, address: str | None = None, serial: str | None = None
    ) -> None:
        """Cut the power for `seconds`; a camera may come back at another address or with another serial number."""
        _require_positive("seconds", seconds)
        if of == GATE:
            self._gate.power_cycle(seconds)
            return
        if of == CAMERAS and (address or serial):
            raise ValueError("of: name one camera; an address or serial number is not for all")
        if address is not None:
            IPv4Address(address)
        for _, camera in self._of(of):
            camera.power_cycle(seconds, address=address, serial=serial)

    def kill(self, of: str) -> None:
        """End a camera at once, as `kill -9` of its process would."""
        for name, camera in self._of(of):
            self._killed.add(name)
            camera.stop()

    def revive(self, of: str) -> None:
        """Start a killed camera again, settings forgotten."""
        for name, camera in self._of(of, alive=False):
            if name in self._killed:
                camera.start()
                self._killed.remove(name)

    def steal_control(self, of: str, seconds: float = 5.0) -> None:
        """Give control of a camera to another application for `seconds`."""
        _require_positive("seconds", seconds)
        for _, camera in self._of(of):
            camera.steal_control(seconds)

    def tamper(self, of: str, feature: str, value: float | str, bank: int = 0) -> None:
        """Change a feature of a camera without the host."""
        for _, camera in self._of(of):
            camera.tamper(feature, value, bank)

    def jump_clock(self, of: str, ms: float) -> None:
        """Let a camera's clock jump."""
        for _, camera in self._of(of):
            camera.jump_clock(round(ms * 1e6))

    def send_malformed(self, of: str, kind: Malformed = "foreign") -> None:
        """Send a datagram that is no packet; unfiltered, `huge` and `abort` harm Aravis 0.8.26."""
        if kind not in get_args(Malformed):
            raise ValueError(f"kind: must be one of {', '.join(get_args(Malformed))}, not {kind!r}")
        for _, camera in self._of(of):
            camera.send_malformed(kind)

    # --- the belt ---

    def start(self) -> None:
        """Start the belt, or go on."""
        self._belt.start()

    def stop(self) -> None:
        """Stop the belt."""
        self._belt.stop()

    def pulse(self) -> None:
        """Let one stone fall now."""
        if self._belt.ended.is_set():
            raise ValueError("pulse: all stones of the recording have fallen; simulate it with --loop")
        self._belt.drop_one()

    def rate(self, hz: float) -> None:
        """Set how many stones fall per second."""
        _require_positive("hz", hz)
        self._belt.rate_hz = hz

    def _of(self, of: str, *, alive: bool = True) -> list[tuple[str, SimulatedCamera]]:
        """Return the named cameras; raises `ValueError` if one was killed and should be `alive`."""
        chosen = [(str(name), camera) for name, camera in self._cameras.items() if of in (name, CAMERAS)]
        if not chosen:
            raise ValueError(f"of: must be one of {', '.join(self._cameras)} or {CAMERAS}, not {of!r}")
        if alive and (killed := self._killed.intersection(name for name, _ in chosen)):
            raise ValueError(f"of: {', '.join(sorted(killed))} was killed: revive it first")
        return chosen


def _require_positive(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or value <= 0:
        raise ValueError(f"{name}: must be a positive number, not {value!r}")
