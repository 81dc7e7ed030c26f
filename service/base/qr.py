"""QR codes as SVG."""

from io import BytesIO


def qr_svg(text: str) -> str:
    """Return the QR code of a text, an SVG without a size of its own."""
    import segno  # imported here: takes 0.1 s, and most answers have none

    drawn = BytesIO()
    segno.make_qr(text, error="m").save(
        drawn, kind="svg", xmldecl=False, omitsize=True, border=2, light="#fff"
    )
    return drawn.getvalue().decode().strip()
