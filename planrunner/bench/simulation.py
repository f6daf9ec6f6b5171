"""A bench whose instruments are simulated by a process of their own: which virtual bench stands behind its addresses, and where that
process is told things.

A run on such a bench takes its clock from the process, which may hasten: real instruments never answer there, so that nothing real is ever
driven by a clock that is not the wall's.
"""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from typing import Any

from planrunner.bench.clock import WallClock
from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Choice, Record, Text, key

LOOPBACK = r"(127\.0\.0\.1|localhost):\d{1,5}"
_PATIENCE = 5.0  # s for an answer


class Simulation(Record):
    """What `planrunner simulate-bench` puts behind the addresses of a bench."""

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


def ask(control: str, request: Mapping[str, Any], token: str | None = None) -> dict[str, Any]:
    """What a simulated bench answers to one request. token: from its readiness file, for a request that changes something. Raises
    `InstrumentError` when none answers or it refuses."""
    host, _, port = control.rpartition(":")
    request = dict(request) if token is None else {**request, "token": token}
    try:
        with socket.create_connection((host, int(port)), _PATIENCE) as connection:
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as replies:
                reply: dict[str, Any] = json.loads(replies.readline() or b'{"error": "it hung up"}')
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        message = f"no simulated bench answers at {control} ({reason}): start it with `planrunner simulate-bench BENCH`"
        raise InstrumentError(message) from None
    if "error" in reply:
        raise InstrumentError(f"the simulated bench at {control} says: {reply['error']}")
    return reply


def attach(simulation: Simulation, addresses: Mapping[str, str]) -> WallClock:
    """A clock that goes as fast as the simulated bench. addresses: of the bench's instruments by name. Raises `InstrumentError` where the
    process does not run, or does not serve all of them."""
    told = ask(simulation.control, {"ask": "bench"})
    for name, address in addresses.items():
        served = told["addresses"].get(name)
        if served != address:
            elsewhere = f"serves '{name}' at {served}" if served else f"has no '{name}'"
            message = f"the simulated bench at {simulation.control} {elsewhere}; the bench file says {address}"
            raise InstrumentError(f"{message}: start `planrunner simulate-bench` with this bench file")
    return WallClock(speed=float(told["speed"]))
