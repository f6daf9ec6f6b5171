"""The control channel of a simulated bench. Requests are lines of JSON on a loopback port, each with one reply.

Every program on the computer can connect to a loopback port, even a web page in a browser. Therefore a request that changes
something must contain the token from the readiness file. If a line is refused, the connection is closed before further data are
read.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
from collections.abc import Callable, Mapping

from planrunner.base.documents import Json
from planrunner.simulators.ports import PortError

_LONGEST = 65536
Handler = Callable[[Mapping[str, Json]], Mapping[str, Json]]


class Control:
    """The control channel of a simulated bench. `handle`: function that answers a request; if it raises a `ValueError`, the reply
    is an error. `token`: text that every request that changes something must contain."""

    def __init__(self, host: str, port: int, handle: Handler):
        self.host, self.port, self.handle = host, port, handle
        self.server: asyncio.Server | None = None
        self.token = secrets.token_urlsafe(24)

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
            answer: Mapping[str, Json] = {}
            while "error" not in answer and (line := await reader.readline()):
                answer = self._answer(line)
                writer.write(json.dumps(answer).encode() + b"\n")
                await writer.drain()
        except (OSError, ValueError):  # gone, or a line without end
            pass
        finally:
            writer.close()

    def _answer(self, line: bytes) -> Mapping[str, Json]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise ValueError("a request must be a mapping")
            token = request.pop("token", "")
            if set(request) != {"ask"} and not self._knows(token):
                raise ValueError("a request that changes something must contain the `token` of the readiness file")
            return self.handle(request)
        except (ValueError, RecursionError) as error:
            return {"error": str(error)}

    def _knows(self, token: object) -> bool:
        return isinstance(token, str) and hmac.compare_digest(token.encode(), self.token.encode())
