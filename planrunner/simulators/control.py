"""The control channel of a simulated bench: requests as lines of JSON on loopback, one answer each."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from typing import Any

from planrunner.simulators.ports import PortError

_LONGEST = 65536
Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]


class Control:
    """handle: answers a request; a `ValueError` of its is told as an error."""

    def __init__(self, host: str, port: int, handle: Handler):
        self.host, self.port, self.handle = host, port, handle
        self.server: asyncio.Server | None = None

    async def listen(self) -> None:
        try:
            self.server = await asyncio.start_server(self._meet, self.host, self.port, limit=_LONGEST)
        except OSError as error:
            raise PortError(f"{self.host}:{self.port}: {error.strerror or error}") from None
        self.port = self.server.sockets[0].getsockname()[1]

    def close(self) -> None:
        if self.server is not None:
            self.server.close()

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self._answer(line)).encode() + b"\n")
                await writer.drain()
        except (OSError, ValueError):  # gone, or a line without end
            pass
        finally:
            writer.close()

    def _answer(self, line: bytes) -> Mapping[str, Any]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise ValueError("a request is a mapping")
            return self.handle(request)
        except ValueError as error:
            return {"error": str(error)}
