"""A camera that wraps another one and injects the faults of a plan."""

from dataclasses import replace

from drivers.errors import CameraUnavailableError, DeviceFault, told
from drivers.faulty.faults import Dice, FaultPlan
from drivers.interfaces import Camera, CameraLost, CameraVitals, DeviceEvent, EventSink
from pipeline.frames import CameraId, Frame, Image


class FaultyCamera:
    """Passes on the frames of the wrapped camera, with the faults of a plan."""

    def __init__(self, camera: Camera, plan: FaultPlan) -> None:
        self._camera = camera
        is_affected = not plan.cameras or camera.id in plan.cameras
        self._plan = plan if is_affected else FaultPlan(seed=plan.seed)
        self._dice = Dice(plan.seed, camera.id)
        self._sink: EventSink | None = None
        self._is_lost = False
        self._n_frames = 0
        self._previous_image: Image | None = None
        self._frozen_image: Image | None = None
        self._delayed: list[Frame] = []

    @property
    def id(self) -> CameraId:
        return self._camera.id

    def open(self) -> None:
        self._camera.open()
        self._is_lost = False

    def arm(self, sink: EventSink) -> None:
        self._sink = sink
        self._camera.arm(self)

    def examine(self) -> CameraVitals:
        if self._is_lost:
            raise CameraUnavailableError(self.id, told(DeviceFault.DEVICE_DISCONNECTED))
        return self._camera.examine()

    def light(self, *, is_on: bool) -> None:
        if self._is_lost:
            raise CameraUnavailableError(self.id, told(DeviceFault.DEVICE_DISCONNECTED))
        self._camera.light(is_on=is_on)

    def disarm(self) -> None:
        self._camera.disarm()
        self._delayed.clear()

    def close(self) -> None:
        self._camera.close()

    def deliver(self, event: DeviceEvent) -> bool:
        """Take an event of the wrapped camera; called on its thread."""
        if self._sink is None or self._is_lost:
            return True
        if not isinstance(event, Frame):
            return self._sink.deliver(event)
        index, self._n_frames = self._n_frames, self._n_frames + 1
        plan = self._plan
        # every fault draws its random number for every frame, so that one fault does not shift the others
        lost, delayed, doubled, swapped, frozen, disconnected = (
            self._dice.strikes(fault, index)
            for fault in (plan.lose, plan.delay, plan.duplicate, plan.swap, plan.freeze, plan.disconnect)
        )
        if disconnected:
            self._is_lost = True
            return self._sink.deliver(
                CameraLost(
                    camera=self.id,
                    received_ns=event.received_ns,
                    reason=told(DeviceFault.DEVICE_DISCONNECTED),
                )
            )
        frame = self._with_wrong_image(event, swapped=swapped, frozen=frozen)
        if lost:
            return True
        if delayed:
            self._delayed.append(frame)
            return True
        arriving = [replace(late, received_ns=frame.received_ns) for late in self._delayed]
        self._delayed.clear()
        arriving += [frame, frame] if doubled else [frame]
        is_taken = True
        for arrived in arriving:
            is_taken &= self._sink.deliver(arrived)
        return is_taken

    def _with_wrong_image(self, frame: Frame, *, swapped: bool, frozen: bool) -> Frame:
        if frozen and self._frozen_image is None:
            self._frozen_image = frame.image
        previous, self._previous_image = self._previous_image, frame.image
        if self._frozen_image is not None:
            return replace(frame, image=self._frozen_image)
        if swapped and previous is not None:
            return replace(frame, image=previous)
        return frame
