"""What the simulated cameras see: the stone that is before them during an exposure, else the empty rig.

A stone shows where the recording has it whenever the exposure is within `SIGHT_MS` of its passing: a trigger
delay that is wrong by more sees nothing, or another stone. Brightness follows exposure time and gain, and at
the recording's own values the pixels are the recording's.
"""

import threading
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.gige_simulator.camera import Exposure, ImageSource
from pipeline.frames import CameraId, Image

SIGHT_MS = 50.0
"""From the middle of the rig, in time; 120 mm at 2.43 m/s."""
KEPT_NS = 3_000_000_000
"""For so long after it passed a stone can be seen by a camera thread that lags behind: 250 MB at four a second."""

Images = Mapping[CameraId, Image]
GREY_LEVELS = np.arange(256)


class Scene:
    """The inside of the rig; thread-safe."""

    def __init__(
        self,
        *,
        empty: Sequence[Images],
        fall_ns: int,
        exposure_us: float,
        gain_db: float,
        sight_ms: float = SIGHT_MS,
        seed: int = 0,
    ) -> None:
        self._empty = empty  # the empty rig, in turn
        self._seed = seed
        self._n_empty = 0
        self._fall_ns = fall_ns  # from the gate to the middle of the rig
        self._exposure_us, self._gain_db = exposure_us, gain_db  # of the recording
        self._sight_ns = round(sight_ms * 1e6)
        self._lock = threading.Lock()
        self._passing: list[tuple[int, Images]] = []  # (when it is in the middle, what is seen)

    def enter(self, edge_ns: int, images: Images) -> None:
        """Something closes the beam at `edge_ns`."""
        with self._lock:
            self._passing = [item for item in self._passing if item[0] > edge_ns - KEPT_NS]
            self._passing.append((edge_ns + self._fall_ns, images))

    def enter_empty(self, edge_ns: int) -> None:
        """Nothing falls, on purpose: all cameras see the same exposure of the empty rig."""
        self.enter(edge_ns, self._empty[self._n_empty % len(self._empty)])
        self._n_empty += 1

    def source_of(self, camera: CameraId) -> ImageSource:
        """What one camera sees."""

        def see(exposure: Exposure) -> NDArray[np.uint8] | None:
            images = self._seen(exposure)
            if (image := images.get(camera)) is None:
                return None
            if len(self._empty) == 1 and images is self._empty[0]:
                image = _taken_anew(image, self._seed + exposure.n)
            return self._lit(image, exposure)

        return see

    def _seen(self, exposure: Exposure) -> Images:
        with self._lock:
            distances_ns = [abs(exposure.exposed_ns - middle_ns) for middle_ns, _ in self._passing]
            nearest_ns = min(distances_ns, default=self._sight_ns)
            if nearest_ns < self._sight_ns:
                return self._passing[distances_ns.index(nearest_ns)][1]
        return self._empty[exposure.n % len(self._empty)]

    def _lit(self, image: Image, exposure: Exposure) -> NDArray[np.uint8]:
        gain = 10 ** ((exposure.gain_db - self._gain_db) / 20)
        factor = gain * exposure.exposure_us / self._exposure_us
        levels = np.clip(np.rint(GREY_LEVELS * factor), 0, 255).astype(np.uint8)
        return image if np.array_equal(levels, GREY_LEVELS) else levels[image]


def _taken_anew(image: Image, n: int) -> Image:
    """The same but for a grey level of one pixel: no sensor delivers the same image twice."""
    other = image.copy()
    other.flat[n % other.size] ^= 1
    return other
