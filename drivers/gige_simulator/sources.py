"""The images of the simulated cameras: the stone that is in view during an exposure, else the empty rig.

A stone is in view while the exposure is within `SIGHT_MS` of its passing the middle, and always appears where it was
recorded: with a trigger delay that is wrong by more, nothing or another stone is seen. Brightness follows exposure
time and gain; at the values of the recording the pixels are those of the recording. Where an output of the cameras
fires the light, a camera whose output is low sees black.
"""

import threading
from collections.abc import Mapping, Sequence

import numpy as np

from drivers.gige_simulator.camera import Exposure, ImageSource
from pipeline.arrays import GreyImage
from pipeline.frames import CameraId, Image

SIGHT_MS = 50.0
"""How long before and after it passes the middle a stone is seen: 120 mm at 2.43 m/s."""
KEPT_NS = 3_000_000_000
"""How long a stone is kept for camera threads that lag behind: 250 MB at four stones a second."""

Images = Mapping[CameraId, Image]
GREY_LEVELS = np.arange(256)


class Scene:
    """The stones in the rig and what each camera sees of them; thread-safe."""

    def __init__(
        self,
        *,
        empty: Sequence[Images],
        fall_ns: int,
        exposure_us: float,
        gain_db: float,
        strobe_line: str | None = None,
        sight_ms: float = SIGHT_MS,
        seed: int = 0,
    ) -> None:
        self._empty = empty  # the empty rig, in turn
        self._seed = seed
        self._n_empty = 0
        self._fall_ns = fall_ns  # from the gate to the middle of the rig
        self._exposure_us, self._gain_db = exposure_us, gain_db  # of the recording
        self._strobe_line = strobe_line  # output that fires the light; None: it is always on
        self._sight_ns = round(sight_ms * 1e6)
        self._lock = threading.Lock()
        self._passing: list[tuple[int, Images]] = []  # (time of passing the middle, images)

    def enter(self, edge_ns: int, images: Images) -> None:
        """Let a stone that closes the beam at `edge_ns` be seen in `images`."""
        with self._lock:
            self._passing = [item for item in self._passing if item[0] > edge_ns - KEPT_NS]
            self._passing.append((edge_ns + self._fall_ns, images))

    def enter_empty(self, edge_ns: int) -> None:
        """Let all cameras see the same exposure of the empty rig, for a test pulse at `edge_ns`."""
        self.enter(edge_ns, self._empty[self._n_empty % len(self._empty)])
        self._n_empty += 1

    def source_of(self, camera: CameraId) -> ImageSource:
        """Return the image source of one camera."""

        def see(exposure: Exposure) -> GreyImage | None:
            images = self._seen(exposure)
            if (image := images.get(camera)) is None:
                return None
            if self._strobe_line is not None and self._strobe_line not in exposure.high_lines:
                return _with_one_pixel_changed(np.zeros_like(image), self._seed + exposure.n)
            if len(self._empty) == 1 and images is self._empty[0]:
                image = _with_one_pixel_changed(image, self._seed + exposure.n)
            return self._lit(image, exposure)

        return see

    def _seen(self, exposure: Exposure) -> Images:
        with self._lock:
            distances_ns = [abs(exposure.exposed_ns - middle_ns) for middle_ns, _ in self._passing]
            nearest_ns = min(distances_ns, default=self._sight_ns)
            if nearest_ns < self._sight_ns:
                return self._passing[distances_ns.index(nearest_ns)][1]
        return self._empty[exposure.n % len(self._empty)]

    def _lit(self, image: Image, exposure: Exposure) -> GreyImage:
        gain = 10 ** ((exposure.gain_db - self._gain_db) / 20)
        factor = gain * exposure.exposure_us / self._exposure_us
        levels = np.clip(np.rint(GREY_LEVELS * factor), 0, 255).astype(np.uint8)
        return image if np.array_equal(levels, GREY_LEVELS) else levels[image]


def _with_one_pixel_changed(image: Image, n: int) -> Image:
    """Return the image with one pixel changed by a grey level: no sensor delivers the same image twice."""
    changed = image.copy()
    changed.flat[n % changed.size] ^= 1
    return changed
