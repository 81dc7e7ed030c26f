"""The sensor of a simulated camera: takes trigger edges, exposes at their time, sends frames to the stream channel."""

import heapq
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import count

from drivers.gige_simulator.clock import CameraClock
from drivers.gige_simulator.counters import SensorTally
from drivers.gige_simulator.design import CameraDesign
from drivers.gige_simulator.faults import DOUBLE_AFTER_MS, Faults
from drivers.gige_simulator.feature_table import USER_OUTPUTS
from drivers.gige_simulator.features import CHUNKS
from drivers.gige_simulator.gvsp import Block, packets
from drivers.gige_simulator.imaging import Exposure, Imaging
from drivers.gige_simulator.registers import Registers
from drivers.gige_simulator.stream import StreamChannel
from drivers.gige_simulator.triggering import LINE_TIME_NS, Plan, TriggerInput
from pipeline.arrays import GreyImage
from pipeline.frames import CameraId

N_WAITING = 8
"""How many exposures may wait for the link before triggers are ignored."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Strobe:
    """A pulse of the `ExposureActive` output of a camera."""

    camera: CameraId
    line: str
    exposed_ns: int  # host's monotonic time
    exposure_us: float


class Sensor:
    """Exposes and sends from one thread of its own."""

    def __init__(
        self,
        design: CameraDesign,
        *,
        registers: Registers,
        clock: CameraClock,
        stream: StreamChannel,
        faults: Faults,
        imaging: Imaging,
        on_strobe: Callable[[Strobe], None] | None,
    ) -> None:
        self.tally = SensorTally()
        self._camera = design.id
        self._registers = registers
        self._clock = clock
        self._stream = stream
        self._faults = faults
        self._link_bytes_s = design.link_bytes_s
        self._imaging = imaging
        self._on_strobe = on_strobe
        self._trigger = TriggerInput(registers)
        self._ways = design.ways
        self._changed = threading.Condition()
        self._plans: list[tuple[int, int, Plan]] = []
        self._order = count()
        self._run = 0  # of the acquisition; 0 before the first
        self._n_exposures = 0
        self._block_id = 0
        self._high: set[int] = set()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    # --- life ---

    def start(self) -> None:
        self._stopping.clear()
        self._thread = threading.Thread(target=self._work, name=f"{self._camera} sensor", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self.end_acquisition()
        self._stopping.set()
        with self._changed:
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def power_on(self) -> None:
        self._n_exposures = 0

    def begin_acquisition(self) -> None:
        with self._changed:
            if self._registers.is_acquiring:
                return
            self._registers.is_acquiring = True
            self._run += 1
            self._block_id = 0
            self._trigger.reset()
            self._run_freely()

    def end_acquisition(self) -> None:
        with self._changed:
            self._registers.is_acquiring = False
            self.tally.aborted += len(self._plans)
            self._plans.clear()

    def trigger_mode_changed(self) -> None:
        with self._changed:
            if not self._plans:
                self._run_freely()

    def tallied(self) -> SensorTally:
        with self._changed:
            return replace(self.tally)

    def skip_blocks(self, n_blocks: int) -> None:
        with self._changed:
            self._block_id += n_blocks

    # --- signals ---

    def level(self, bank: int) -> bool:
        """Return `LineStatus` of the line in a bank: whether it is high."""
        return bank in self._high

    def line(self, name: str, at_ns: int, *, rising: bool) -> None:
        """Take an electrical edge; a line that is an output ignores it."""
        bank = self._registers.features["LineSelector"].entries[name]
        if self._registers.choice("LineMode", bank) == "Output":
            return
        rising ^= bool(self._registers.number("LineInverter", bank))
        (self._high.add if rising else self._high.discard)(bank)
        for source in [entry for entry, line in self._ways.sources.items() if line == name]:
            self.edge(source, at_ns, rising=rising)

    def edge(self, source: str, at_ns: int, *, rising: bool | None = None, bank: int | None = None) -> None:
        """Take a trigger signal of `source`.

        `rising` is None for signals without edges (software, action); `bank` restricts a signal to one trigger.
        """
        with self._changed:
            banks = self._trigger.banks(source, rising=rising)
            if bank is not None:
                banks = [listening for listening in banks if listening == bank]
            bounces = rising is not None and self._trigger.bounces(self._ways.sources[source], at_ns)
            if rising is False and not banks:
                return
            self.tally.edges += 1
            if bounces:
                self.tally.debounced += 1
            elif self._faults.missed_triggers > 0:
                self._faults.missed_triggers -= 1
                self.tally.unseen += 1
            else:
                self._take(banks, at_ns)

    def _take(self, banks: list[int], at_ns: int) -> None:
        self.tally.heard += bool(banks)
        is_ready = self._registers.is_acquiring and bool(banks) and len(self._plans) < N_WAITING
        if is_ready and self._trigger.starts_burst(banks):
            self.tally.triggers += 1
            return
        plan = self._trigger.accept(banks, at_ns) if is_ready else None
        if plan is None:
            self.tally.missed += 1
            return
        self.tally.triggers += 1
        self._push(plan)
        for n in range(1, self._trigger.n_burst):  # as fast as they are read out
            self._push(
                replace(
                    plan, exposed_ns=plan.exposed_ns + n * self._registers.number("Height") * LINE_TIME_NS
                )
            )
        if self._faults.doubled_triggers > 0:
            self._faults.doubled_triggers -= 1
            self._push(replace(plan, exposed_ns=plan.exposed_ns + round(DOUBLE_AFTER_MS * 1e6)))

    def _push(self, plan: Plan) -> None:
        self.tally.exposures += 1
        heapq.heappush(self._plans, (plan.exposed_ns, next(self._order), plan))
        self._changed.notify_all()

    def _run_freely(self, after: Plan | None = None) -> None:
        """Plan the next exposure of an untriggered acquisition."""
        registers = self._registers
        if not registers.is_acquiring or self._trigger.is_triggered():
            return
        at_ns = time.monotonic_ns()
        if after is not None:
            period_ns = round(after.exposure_us * 1000) + registers.number("Height") * LINE_TIME_NS
            if registers.number("AcquisitionFrameRateEnable"):
                period_ns = max(period_ns, round(1e9 / registers.quantity("AcquisitionFrameRate")))
            at_ns = max(at_ns, after.exposed_ns + period_ns)
        if plan := self._trigger.plan(at_ns, at_ns):
            self._push(plan)

    # --- the thread ---

    def _work(self) -> None:
        while due := self._wait_for_due():
            plan, run = due
            self._expose(plan, run)
            with self._changed:
                if self._is_current(run) and not self._plans:
                    self._run_freely(after=plan)

    def _wait_for_due(self) -> tuple[Plan, int] | None:
        with self._changed:
            while not self._stopping.is_set():
                wait_s = None
                if self._plans:
                    wait_s = (self._plans[0][0] - time.monotonic_ns()) / 1e9
                    if wait_s <= 0:
                        _, _, plan = heapq.heappop(self._plans)
                        self.tally.started += 1
                        return plan, self._run
                self._changed.wait(wait_s)
            return None

    def _is_current(self, run: int) -> bool:
        return self._registers.is_acquiring and run == self._run and not self._stopping.is_set()

    def _expose(self, plan: Plan, run: int) -> None:
        """Expose, read out and send; takes as long as a real camera does."""
        registers, faults = self._registers, self._faults
        self._n_exposures += 1
        self._strobe(plan)
        end_s = plan.exposed_ns / 1e9 + (plan.exposure_us + faults.late_ms * 1000) / 1e6
        self._stopping.wait(max(0.0, end_s - time.monotonic()))
        image = self._imaging.take(
            Exposure(
                camera=self._camera,
                n=self._n_exposures,
                trigger_ns=plan.trigger_ns,
                exposed_ns=plan.exposed_ns,
                exposure_us=plan.exposure_us,
                gain_db=registers.quantity("Gain"),
                high_lines=tuple(line for line, source in self._outputs() if self._is_high(source)),
            )
        )
        with self._changed:
            if not self._is_current(run):
                self.tally.aborted += 1
                return
            has_extended_ids = registers.choice_or("GevGVSPExtendedIDMode", "Off") == "On"
            self._block_id = self._block_id + 1 if has_extended_ids else self._block_id % 0xFFFF + 1
            if image is None:
                self.tally.unexposed += 1
                return
            if faults.swallowed_frames > 0:
                faults.swallowed_frames -= 1
                self.tally.swallowed += 1
                return
            block = self._block(plan, image, has_extended_ids=has_extended_ids)
        self._stream.send(
            block.block_id,
            packets(block),
            due_s=end_s,
            rate_bytes_s=min(
                self._link_bytes_s,
                registers.number("DeviceLinkThroughputLimit"),
                image.shape[1] * 1e9 / LINE_TIME_NS,  # not faster than it is read out
            ),
            gap_ns=registers.number("GevSCPD"),
            is_wanted=lambda: self._is_current(run),
        )
        if registers.choice("AcquisitionMode") == "SingleFrame":
            self.end_acquisition()

    def _block(self, plan: Plan, image: GreyImage, *, has_extended_ids: bool) -> Block:
        registers = self._registers
        device_ns = self._clock.device_ns(plan.exposed_ns)
        values: dict[str, int | float] = {
            "Timestamp": device_ns,
            "FrameID": self._block_id,
            "ExposureTime": plan.exposure_us,
            "CounterValue": self.tally.heard,
        }
        chunks = tuple(
            (name, values[name]) for bank, name in enumerate(CHUNKS) if registers.number("ChunkEnable", bank)
        )
        return Block(
            block_id=self._block_id,
            has_extended_ids=has_extended_ids,
            packet_bytes=registers.number("GevSCPSPacketSize"),
            device_ns=device_ns,
            image=image,
            offset_px=(registers.number("OffsetX"), registers.number("OffsetY")),
            chunks=chunks if registers.number("ChunkModeActive") else None,
            chunk_payload=self._ways.chunk_payload,
            pixel_format=registers.choice("PixelFormat"),
        )

    def _strobe(self, plan: Plan) -> None:
        if self._on_strobe is None:
            return
        for line, source in self._outputs():
            if source == "ExposureActive":
                self._on_strobe(
                    Strobe(
                        camera=self._camera,
                        line=line,
                        exposed_ns=plan.exposed_ns,
                        exposure_us=plan.exposure_us,
                    )
                )

    def _outputs(self) -> Iterator[tuple[str, str]]:
        """Yield the name and the source of each line that is an output."""
        registers = self._registers
        for line, bank in registers.features["LineSelector"].entries.items():
            if registers.choice("LineMode", bank) == "Output":
                yield line, registers.choice("LineSource", bank)

    def _is_high(self, source: str) -> bool:
        """True when an output of this source is high during an exposure."""
        if source in USER_OUTPUTS:
            return bool(self._registers.number("UserOutputValue", USER_OUTPUTS.index(source)))
        return source == "ExposureActive"
