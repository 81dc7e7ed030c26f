"""An acquisition, with everything it tells written down in order."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager

from support.eventually import PATIENCE_S

from drivers.factory import Devices
from pipeline.frames import CameraId, FrameBundle, GateCount, Trigger
from service.acquisition.acquisition import Acquisition, AcquisitionParameters
from service.acquisition.empty_rig import EmptyRigParameters
from service.base.status import AcquisitionState, AcquisitionTarget
from service.bundling.window import BundlingParameters

CAMERAS = (CameraId("c01"), CameraId("c02"), CameraId("c03"))
DELAY_NS = 259_400_000
UTC = "2026-11-21T04:00:00Z"


class AcquisitionBench:
    """In the place of the store and of who measures."""

    def __init__(
        self, devices: Devices, *, min_cameras: int = 2, is_ball: Callable[[], bool] = lambda: False
    ) -> None:
        self.devices = devices
        self.told: list[tuple[str, str]] = []
        self.n_records = 0
        self.gate_counts: list[GateCount | None] = []
        self.bundles: list[FrameBundle] = []
        self.states: list[AcquisitionState] = []
        self.entered: list[tuple[AcquisitionState, str | None]] = []
        self.trouble: str | None = None
        self._min_cameras = min_cameras
        self._is_ball = is_ball
        self.make_acquisition()

    def make_acquisition(self) -> None:
        self.acquisition = Acquisition(
            self.devices,
            AcquisitionParameters(
                session=1,
                bundling=BundlingParameters(),
                min_cameras=self._min_cameras,
                empty_rig=EmptyRigParameters(at_start=0, every_s=0),
            ),
            triggers=self,
            is_ball=self._is_ball,
            on_bundle=self.on_bundle,
            on_progress=self.on_progress,
            on_state=lambda state, trouble: self.entered.append((state, trouble)),
        )

    async def forget_gate_count(self, session: int) -> None:
        self.gate_counts.append(None)

    async def record_triggers(
        self, session: int, triggers: Mapping[str, Trigger], gate_count: GateCount | None
    ) -> None:
        self.gate_counts.append(gate_count)
        await asyncio.sleep(0)
        self.n_records += 1
        for bundle, trigger in triggers.items():
            assert trigger.name == bundle
            self.told.append(("trigger", bundle))

    def on_bundle(self, bundle: FrameBundle) -> None:
        self.told.append(("bundle", bundle.name))
        self.bundles.append(bundle)

    def on_progress(self) -> None:
        self.states.append(self.acquisition.state)

    async def until(self, condition: Callable[[], bool]) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while not condition():  # noqa: ASYNC110 - what is waited for happens in many places
                await asyncio.sleep(0.005)


@asynccontextmanager
async def armed(bench: AcquisitionBench) -> AsyncIterator[Acquisition]:
    """Runs the acquisition, and stops it in order."""
    acquisition = bench.acquisition
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(acquisition.run())
        assert acquisition.request(AcquisitionTarget.ARMED) is AcquisitionState.ARMING
        await acquisition.settled.wait()
        yield acquisition
        acquisition.stop()
        await running
