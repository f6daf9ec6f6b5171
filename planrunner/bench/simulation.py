"""Communicates with a separate process that simulates a bench at the addresses in the bench file.

A run on such a bench uses the clock of the process, which may be faster than real time. Real instruments never answer at these
addresses. Therefore, a clock of this kind never controls anything real.
"""

from __future__ import annotations

from collections.abc import Mapping

from planrunner.base.documents import Json, JsonObject
from planrunner.bench.clock import WallClock
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Choice, Record, Text, key

LOOPBACK = r"(127\.0\.0\.1|localhost):\d{1,5}"
_PATIENCE = 30.0  # s for an answer, which a busy computer may delay


class SimulationSpec(Record):
    """Describes the bench that `planrunner simulate-bench` serves at the addresses of a bench file."""

    bench: str = key(
        Text(),
        "Virtual bench whose table, chamber and sensor are served at the addresses of this bench: a shipped name, or "
        "a file in the same folder.",
        "virtual",
    )
    control: str = key(
        Text(LOOPBACK, "an address on loopback", "such as 127.0.0.1:9870"),
        "Address at which the simulated bench reports its clock and accepts faults.",
        "127.0.0.1:9870",
    )
    framing: str = key(
        Choice(("words", "ascii")),
        "Header of each reply of a simulated ACUTROL over TCP: error code and length as two words, or as eight "
        "characters.",
        "ascii",
        default="words",
    )


def ask(control: str, request: Mapping[str, Json], token: str | None = None) -> JsonObject:
    """Sends one request to a simulated bench and returns the answer. `token`: the token in the readiness file of the simulated
    bench; requests that change something need it. Raises `InstrumentError` if nothing answers or the request is refused."""
    import json
    import socket

    host, _, port = control.rpartition(":")
    request = dict(request) if token is None else {**request, "token": token}
    try:
        with socket.create_connection((host, int(port)), _PATIENCE) as connection:
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as replies:
                reply: JsonObject = json.loads(
                    replies.readline() or b'{"error": "the connection was closed before an answer arrived"}'
                )
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or error
        message = f"no simulated bench answers at {control} ({reason}): start it with `planrunner simulate-bench BENCH`"
        raise InstrumentError(message) from None
    if "error" in reply:
        raise InstrumentError(f"the simulated bench at {control} reports: {reply['error']}")
    return reply


def attach(simulation: SimulationSpec, addresses: Mapping[str, str]) -> WallClock:
    """Checks that the process of the simulated bench serves every instrument at its address, and returns a clock at the speed of
    that process. `addresses`: address of each instrument, by its name in the bench. Raises `InstrumentError` if the process does
    not answer or an instrument has another address there."""
    told = ask(simulation.control, {"ask": "bench"})
    for name, address in addresses.items():
        served = told["addresses"].get(name)
        if served != address:
            elsewhere = f"serves '{name}' at {served}" if served else f"has no '{name}'"
            message = f"the simulated bench at {simulation.control} {elsewhere}; the bench file says {address}"
            raise InstrumentError(f"{message}: start `planrunner simulate-bench` with this bench file")
    return WallClock(speed=float(told["speed"]))
