"""What the picture of a recording shows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree import ElementTree

SHOWN = 6
"""Channels of one kind in a chart."""


def check_picture(svg: str, channels: Sequence[str]) -> None:
    """The picture has a chart for each kind of channel, with a line for each channel. `channels`: names as in the bench file."""
    kinds: dict[str, list[str]] = {}
    for name in channels:
        kinds.setdefault(name.split("_")[0], []).append(name)
    root = ElementTree.fromstring(svg)
    texts = ["".join(one.itertext()) for one in root.iter() if one.tag.endswith("text")]
    for kind, names in kinds.items():
        assert any(text.startswith(f"{kind} [") for text in texts), kind
        assert {*names[:SHOWN]} <= {*texts}, texts
    lines = [
        one
        for one in root.iter()
        if one.tag.endswith("path") and one.get("clip-path") and one.get("stroke-width") == "0.9"
    ]
    assert len(lines) == sum(len(names[:SHOWN]) for names in kinds.values())
    assert all(len(re.findall("[ML]", one.get("d", ""))) > 1 for one in lines)
