"""Byte-exact frames of real sensors with their decoded values, which lie beside the real recordings and are not part of the project."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from planrunner.instruments.sensors.samples import Decoder, Samples
from planrunner.instruments.wire.framing import Framer, Piece


@cache
def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def vectors_beside(data_root: Path) -> dict[str, Any]:
    """The vectors; the test is skipped where there are none."""
    path = data_root.parent / "wire" / "vectors.json"
    if not path.is_file():
        pytest.skip(f"no published frames in {path}; set PLANRUNNER_DATA")
    return _read(path)


def decoded(decoder: Decoder, stream: bytes) -> tuple[Samples, Framer]:
    """All samples of a stream."""
    framer = Framer(decoder.framing)
    return decoder.decode(framer.push([Piece(1.0, stream)])), framer
