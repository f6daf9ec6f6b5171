"""`planrunner simulate-bench`: serves simulated instruments at the addresses in a bench file, and injects faults into them."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from planrunner.base.documents import JsonObject
from planrunner.base.findings import COMMAND_LINE, InputError, Mark
from planrunner.base.regular_files import RefusedFileError, read_regular
from planrunner.bench.model import Bench, read_bench
from planrunner.bench.simulation import ask
from planrunner.cli import exit_codes
from planrunner.cli.arguments import SEED
from planrunner.plan.kinds import Record

if TYPE_CHECKING:
    from planrunner.simulators.serving import Serving

_LONGEST_NOTE = 1_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bench", metavar="BENCH", help="bench with `simulation`: a shipped name or a file")
    parser.add_argument(
        "--speed", type=_speed, default=1.0, help="simulated seconds per second of real time (default: 1)"
    )
    parser.add_argument("--faults", metavar="FILE", type=Path, help="fault script: which faults occur, and when")
    parser.add_argument(
        "--copy",
        metavar="FILE",
        type=Path,
        help="serve at free addresses, and write a bench file with these addresses to FILE",
    )
    parser.add_argument(
        "--ready",
        metavar="FILE",
        type=Path,
        help="readiness file: written with addresses and token as JSON as soon as all instruments listen; --inject, "
        "--clear and --stop read the token from it",
    )
    parser.add_argument("--seed", type=SEED, help="seed of the simulation (default: the virtual bench's own)")
    parser.add_argument(
        "--inject",
        metavar="FAULT",
        help="inject a fault into a running simulated bench: '{instrument: table, fault: silent}'",
    )
    parser.add_argument("--clear", metavar="NUMBER", help="end a fault of a running simulated bench, or `all` faults")
    parser.add_argument("--stop", action="store_true", help="end a running simulated bench")


def _speed(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"the speed must be a number: {text!r}") from None
    if not 0.01 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"the speed must be from 0.01 to 1000: {text}")
    return value


def run(args: argparse.Namespace) -> int:
    bench, data, shown = read_bench(args.bench)
    request = _request(args)
    if request is not None:
        return _tell(bench, request, args.ready)
    import asyncio

    return asyncio.run(_serve(args, bench, data, shown))


def _request(args: argparse.Namespace) -> JsonObject | None:
    if args.inject is not None:
        return {"inject": args.inject}
    if args.clear is not None:
        return {"clear": args.clear}
    return {"stop": True} if args.stop else None


def _tell(bench: Bench, request: JsonObject, ready: Path | None) -> int:
    from planrunner.simulators.from_bench import simulation_of

    control = simulation_of(bench).control
    reply = ask(control, request, _token(ready, control))
    print(", ".join(f"{name}: {value}" for name, value in reply.items()))
    return exit_codes.DONE


def _token(ready: Path | None, control: str) -> str:
    """Reads, from the readiness file of a running simulated bench, the token that authorises commands to that bench. Raises
    `InputError` if the file cannot be read."""
    start = "start the simulated bench with `--ready FILE`, and give the same file here"
    if ready is None:
        message = "a running simulated bench accepts commands only with the token of its readiness file"
        raise InputError.at(COMMAND_LINE, "simulation-token", message, start)
    try:
        note = json.loads(read_regular(ready, _LONGEST_NOTE))
        token, served = str(note["token"]), str(note["control"])
    except RefusedFileError as error:
        raise InputError.at(Mark(str(ready)), "simulation-token", str(error), start) from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError.at(Mark(str(ready)), "simulation-token", "this is not a readiness file", start) from None
    if served != control:
        message = f"this readiness file belongs to the simulated bench at {served}, not to the one at {control}"
        raise InputError.at(
            Mark(str(ready)), "simulation-token", message, "give the bench file of that simulated bench"
        )
    return token


def _write_ready(ready: Path, note: str) -> None:
    """Writes the readiness file atomically. Only the user may read it, because its token permits commands to the simulated bench."""
    waiting = ready.with_name(ready.name + ".new")
    waiting.unlink(missing_ok=True)
    with open(os.open(waiting, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        file.write(note)
    waiting.replace(ready)


async def _serve(args: argparse.Namespace, bench: Bench, data: bytes, shown: str) -> int:
    import asyncio

    from planrunner.simulators.faults import read_script
    from planrunner.simulators.from_bench import simulated, simulation_of
    from planrunner.simulators.live_world import RunningClock
    from planrunner.simulators.serving import Serving, ready_note

    control = simulation_of(bench).control
    made = simulated(bench, args.bench, RunningClock(args.speed), args.seed)
    script = read_script(args.faults, made.roles) if args.faults else ()
    host, _, port = control.rpartition(":")
    folder = args.copy.parent if args.copy else None
    serving = Serving(made, (host, 0 if folder else int(port)), args.speed, folder)
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows: Ctrl-C still ends it
            asyncio.get_running_loop().add_signal_handler(number, serving.ended.set)
    try:
        await serving.open()
        serving.declare(script)
        if args.copy:
            args.copy.write_bytes(_copied(data, bench, control, serving))
        for name, address in serving.addresses.items():
            print(f"{name:<16} {bench.instruments[name].driver:<16} {address}")
        print(f"{'control':<33} {serving.control.host}:{serving.control.port}")
        print(f"ready, at {args.speed:g} times real time; Ctrl-C ends it", flush=True)
        if args.ready:
            _write_ready(args.ready, ready_note(serving))
        await serving.run()
    finally:
        serving.close()
        if args.ready:
            args.ready.unlink(missing_ok=True)
    return exit_codes.DONE


def _copied(data: bytes, bench: Bench, control: str, serving: Serving) -> bytes:
    """Returns the text of the bench file after replacing each address by the address at which the instrument is served."""
    from planrunner.bench.model import driver_of
    from planrunner.instruments.interfaces import Addressed
    from planrunner.simulators.from_bench import simulation_of

    places: list[tuple[Record, str, str, str]] = [
        (simulation_of(bench), "control", control, f"{serving.control.host}:{serving.control.port}")
    ]
    for name, served in serving.addresses.items():
        parameters, driver = bench.instruments[name].parameters, driver_of(bench.instruments[name])
        assert issubclass(driver, Addressed)  # it is served at its address
        written = driver.address(parameters)
        key = next(item for item in ("address", "port") if item in parameters.origin.keys)
        places.append((parameters, key, written, served))
    lines = data.decode("utf-8").splitlines(keepends=True)
    marked = [(record.at(key), written, served) for record, key, written, served in places]
    for mark, written, served in sorted(marked, key=lambda item: (item[0].line, item[0].column), reverse=True):
        before = "".join(lines[: mark.line - 1]) + lines[mark.line - 1][: mark.column - 1]
        after = "".join(lines)[len(before) :]
        lines = (before + after.replace(written, served, 1)).splitlines(keepends=True)
    return "".join(lines).encode("utf-8")
