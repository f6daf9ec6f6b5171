"""Text that comes from files, for a terminal that it must not drive."""

from __future__ import annotations


def printable(text: str, keep: str = "\n") -> str:
    r"""Control characters as codes such as `\x1b`, but those in `keep` as they are."""
    return "".join(char if char.isprintable() or char in keep else f"\\x{ord(char):02x}" for char in text)
