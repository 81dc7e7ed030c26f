"""Images of strangers as those of one rig: one size, eight bits, all of them photographs or all of them masks."""

from collections import Counter
from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.image_file import read_image
from pipeline.frames import Image
from pipeline.segmentation.mask_segmenter import mask_of

MOST_BITS = 16


class ImageReader:
    """Reads images of one size as 8 bits; counts how deep they were in `depths`.

    `bits` is what the camera gave where files of 16 bits hold fewer, None: all of them. With `masks` all images are
    masks of two grey levels.
    """

    def __init__(self, source: Path, size_px: tuple[int, int], bits: int | None, masks: bool) -> None:
        self._source, self._size_px, self._bits, self._masks = source, size_px, bits, masks
        self._greatest = 0  # level of the images of 16 bits
        self.depths: Counter[int] = Counter()

    def read(self, path: Path) -> Image:
        """Return an image (H, W).

        Raises
        ------
        RecordingError
            As `read_image`; or it has another size, is a mask where a photograph is needed or a photograph where a
            mask is, or a level is beyond the bits that the camera gave.
        """
        found = read_image(path)
        if found.pixels.shape != self._size_px[::-1]:
            height_px, width_px = found.pixels.shape
            wanted = "x".join(map(str, self._size_px))
            raise RecordingError(path, f"has {width_px}x{height_px} pixels; the rig's camera has {wanted}")
        mask = mask_of(found.pixels)
        if self._masks:
            if mask is None:
                raise RecordingError(path, "has more than two grey levels: with --masks all images are masks")
            return mask
        if mask is not None and mask.any():
            raise RecordingError(
                path, "has two grey levels only: it is a mask, not a photograph; `import --masks` takes masks"
            )
        bits = found.bits
        if bits == MOST_BITS:
            bits = self._bits or bits
            self._greatest = max(self._greatest, int(found.pixels.max()))
            if self._greatest >> bits:
                raise RecordingError(path, f"has grey level {self._greatest}, which is more than {bits} bits")
        self.depths[bits] += 1
        return found.to_8_bits(bits)

    def require_known_depth(self) -> None:
        """Raise `RecordingError` where files have 16 bits, and no pixel uses the upper four."""
        if self.depths[MOST_BITS] and self._bits is None and self._greatest >> (MOST_BITS - 4) == 0:
            raise RecordingError(
                self._source,
                f"has images of 16 bits without a grey level above {self._greatest}: name what the camera gave, as"
                f" with --bits {max(self._greatest.bit_length() + 1 & ~1, 10)} (or {MOST_BITS})",
            )
