"""Pictures of stones, looked at before a document takes them."""

from io import BytesIO

from PIL import Image

MAX_PIXELS = 4_000_000
"""A larger picture is no preview: it would cost the memory of the reader's process."""


def readable_png(png: bytes | None) -> bytes | None:
    """Return the picture if it is a sound PNG of moderate size, else None."""
    if png is None:
        return None
    try:
        with Image.open(BytesIO(png), formats=("PNG",)) as image:
            if image.width * image.height > MAX_PIXELS:
                return None
            image.load()
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None
    return png


def sound_png(png: bytes) -> bytes | None:
    """Return a readable picture encoded anew: typst refuses a PNG that Pillow reads in spite of a damaged end."""
    if readable_png(png) is None:
        return None
    sound = BytesIO()
    with Image.open(BytesIO(png), formats=("PNG",)) as image:
        image.save(sound, "PNG", compress_level=1)
    return sound.getvalue()
