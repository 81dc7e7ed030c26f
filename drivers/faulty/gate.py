"""A light gate that wraps another one and injects the faults of a plan."""

from collections.abc import Callable
from dataclasses import replace

from drivers.errors import DeviceFault, told
from drivers.faulty.faults import Dice, FaultPlan
from drivers.gates.wrapped import WrappedGate
from drivers.interfaces import DeviceEvent, EventSink, GateLost, LightGate, TriggersIgnored
from pipeline.frames import Trigger

BOUNCE_NS = 3_000_000
"""From an edge to its bounce, or to the second trigger of a stone that is counted twice."""


class FaultyGate(WrappedGate):
    """Passes on the triggers of the wrapped gate, with the faults of a plan.

    `on_swallowed` is called for every trigger that is not passed on.
    """

    def __init__(
        self, gate: LightGate, plan: FaultPlan, on_swallowed: Callable[[], None] = lambda: None
    ) -> None:
        super().__init__(gate)
        self._plan = plan
        self._on_swallowed = on_swallowed
        self._dice = Dice(plan.seed, "gate")
        self._n_triggers = 0
        self._n_doubled = 0

    def _pass_on(self, event: DeviceEvent, sink: EventSink) -> bool:
        if not isinstance(event, Trigger):
            return self._is_lost or sink.deliver(event)
        index, self._n_triggers = self._n_triggers, self._n_triggers + 1
        plan = self._plan
        lost, doubled, bounced, disconnected = (
            self._dice.strikes(fault, index)
            for fault in (
                plan.lose_trigger,
                plan.double_trigger,
                plan.bounce_trigger,
                plan.disconnect_gate,
            )
        )
        if disconnected and not self._is_lost:
            self._is_lost = True
            sink.deliver(
                GateLost(received_ns=event.received_ns, reason=told(DeviceFault.DEVICE_DISCONNECTED))
            )
        if lost or self._is_lost:
            self._on_swallowed()
            return True
        trigger = replace(event, sequence=event.sequence + self._n_doubled)
        is_taken = sink.deliver(trigger)
        echo_ns = trigger.received_ns + BOUNCE_NS
        if bounced:
            sink.deliver(TriggersIgnored(received_ns=echo_ns, count=1, reason="bounce"))
        if doubled:
            self._n_doubled += 1
            name = None if trigger.name is None else f"{trigger.name}-double"
            is_taken &= sink.deliver(
                replace(trigger, sequence=trigger.sequence + 1, received_ns=echo_ns, name=name)
            )
        return is_taken
