"""The digest of a seal as a QR code (ISO/IEC 18004), so that a printed page can be compared with the run folder without typing."""

from __future__ import annotations

PREFIX = "planrunner:seal:sha256:"
"""What the code begins with; the 64 hexadecimal digits follow."""
MODULE = 2
"""Width of a module on the screen, CSS pixels; 0.5 mm in print, which phones read."""


def seal_code(digest: str) -> str:
    """The code of a digest as inline SVG, black on white in every colour scheme. The page gives the alternative text."""
    import segno

    code = segno.make(PREFIX + digest, error="m", micro=False)
    return code.svg_inline(
        scale=MODULE, border=4, dark="#000", light="#fff", svgclass="seal-code", lineclass=None, omitsize=False
    )
