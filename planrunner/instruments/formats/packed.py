"""Opens text files that may be packed with gzip. A packed file is unpacked while it is read, and only up to a limit."""

from __future__ import annotations

import gzip
import io
import zlib
from pathlib import Path
from typing import BinaryIO

from planrunner.instruments.formats.file import open_samples
from planrunner.instruments.interfaces import InstrumentError

MAX_UNPACKED_TEXT = 10_000_000_000
"""Maximum number of bytes of a packed text after unpacking. At the highest compression ratio of gzip, the packed file has about a
thousandth of this size."""
GZIP = b"\x1f\x8b"


def open_text(path: Path, name: str) -> BinaryIO:
    """Opens a text file, positioned at its start. If it is packed with gzip, its unpacked contents are read. `name`: name of the
    file, used in messages. Raises `InstrumentError` if the file is not a regular file or is too large. If a packed file is damaged,
    or is too large after unpacking, reading raises `InstrumentError`."""
    file = open_samples(path, name)
    start = file.read(len(GZIP))
    file.seek(0)
    return io.BufferedReader(_Unpacked(file, name), 1 << 20) if start == GZIP else file


def text_size(path: Path, name: str, start: int) -> int:
    """Estimates the number of bytes of a text, after unpacking. `start`: number of unpacked bytes from which the compression ratio
    is estimated. Raises `InstrumentError` if the file cannot be opened."""
    with open_samples(path, name) as file:
        packed = file.read(len(GZIP)) == GZIP
        size = file.seek(0, 2)
        if not packed:
            return size
        file.seek(0)
        unpack, count = zlib.decompressobj(wbits=31), 0
        while count < start and not unpack.eof and (piece := file.read(512)):
            try:
                count += len(unpack.decompress(piece))
            except zlib.error:
                break
        return count * size // max(file.tell(), 1)


class _Unpacked(io.RawIOBase):
    """The unpacked contents of a file."""

    def __init__(self, file: BinaryIO, name: str):
        self._file, self._name = file, name
        self._text = gzip.GzipFile(fileobj=file, mode="rb")

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._text.tell() if (offset, whence) == (0, 1) else self._text.seek(offset, whence)

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        try:
            count = self._text.readinto(buffer)
        except (OSError, EOFError, zlib.error) as error:
            reason = "it ends too early" if isinstance(error, EOFError) else str(error)[:100]
            raise InstrumentError(
                f"{self._name} cannot be unpacked: {reason}; pack it again, or unpack it first"
            ) from None
        if self._text.tell() > MAX_UNPACKED_TEXT:
            message = f"it has more than {MAX_UNPACKED_TEXT / 1e9:g} GB after unpacking"
            raise InstrumentError(f"{self._name}: {message}; unpack it first")
        return count

    def close(self) -> None:
        super().close()
        self._file.close()
