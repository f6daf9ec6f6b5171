"""Operates a simulated bench: listens at the addresses, advances the simulated world, injects faults, and ends on request."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.control import Control
from planrunner.simulators.faults import AILMENTS, CHAMBER, TABLE, Fault, FaultBoard, read_fault, struck
from planrunner.simulators.from_bench import Simulated, Spoken
from planrunner.simulators.message_port import MessagePort, TcpMessages, TerminalMessages
from planrunner.simulators.ports import Address, PseudoTerminal, SerialLine, Socket
from planrunner.simulators.table_plant import TablePlant

TICK = 0.005  # s between two updates


class Serving:
    """A simulated bench in operation: its instruments, ports, faults and control channel. `addresses`: address of each instrument,
    as it is written in a bench file; known after `open`."""

    def __init__(self, simulated: Simulated, control: tuple[str, int], speed: float, folder: Path | None = None):
        self.simulated, self.live, self.speed, self.folder = simulated, simulated.live, speed, folder
        self.board = FaultBoard()
        self.draw = np.random.default_rng([self.live.world.seed, 1])
        self.control = Control(*control, self.handle)
        self.messages: dict[str, TcpMessages | TerminalMessages] = {}
        self.line: SerialLine | None = None
        self.addresses: dict[str, str] = {}
        self.ended = asyncio.Event()

    # -- from beginning to end -----------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Starts to listen at every address. Raises `PortError` if an address is in use or not possible."""
        for item in self.simulated.spoken:
            await self._listen(item)
        sensor = self.simulated.sensor
        if sensor is not None:
            address = self._placed(sensor.address, sensor.name)
            port: PseudoTerminal | Socket
            if address.link is None:
                port = Socket(address.host, address.port, self._heard)
                await port.listen()
                self.addresses[sensor.name] = address.written(port.port)
            else:
                port = PseudoTerminal(address.link, self._heard)
                self.addresses[sensor.name] = address.written()
            self.line = SerialLine(port, sensor.baud, self.speed, time.monotonic())
        await self.control.listen()

    async def run(self) -> None:
        """Runs until `ended` is set."""
        while not self.ended.is_set():
            self.tick()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.ended.wait(), TICK)

    def close(self) -> None:
        self.control.close()
        for port in self.messages.values():
            port.refuse()
        if self.line is not None:
            self.line.port.close()

    def _placed(self, address: Address, name: str) -> Address:
        return address if self.folder is None else address.elsewhere(self.folder, name)

    async def _listen(self, item: Spoken) -> None:
        address = self._placed(item.address, item.name)
        messages = MessagePort(item.name, item.controller, item.manner, self.board, self.live.now)
        if address.link is not None:
            self.messages[item.name] = TerminalMessages(messages, address.link)
            self.addresses[item.name] = address.written()
            return
        port = TcpMessages(messages, address.host, address.port)
        await port.listen()
        self.messages[item.name] = port
        self.addresses[item.name] = address.written(port.port)

    # -- operation --------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Brings all parts of the simulation up to the present time."""
        begun, over = self.board.changes(self.live.now())
        for fault in begun:
            self._strike(fault, True)
        for fault in over:
            self._strike(fault, False)
        for port in self.messages.values():
            port.attend()
            port.messages.controller.watch()
            port.messages.say_later()
        sensor, line = self.simulated.sensor, self.line
        if sensor is None or line is None:
            return
        line.port.attend()
        faults = self.board.active(sensor.name, self.live.now())
        sensor.unit.ails = AILMENTS & {fault.fault for fault in faults}
        for block in sensor.feed.take():
            line.offer(struck(sensor.unit.frames(block), faults, self.draw))
        line.pump(time.monotonic())

    def _heard(self, data: bytes) -> None:
        assert self.simulated.sensor is not None
        if self.line is not None:
            self.line.reply(self.simulated.sensor.unit.hear(data))

    def _strike(self, fault: Fault, begins: bool) -> None:
        """Applies a fault when it begins, and removes the fault when it ends."""
        if fault.fault in ("unplug", "refuse"):
            self._pull(fault, begins)
            return
        plants = {item.name: item.controller.plant for item in self.simulated.spoken}
        plant = plants.get(fault.instrument)
        if isinstance(plant, TablePlant) and fault.fault in TABLE:
            if fault.fault == "interlock open":
                plant.open_interlock(begins)
            elif begins:
                plant.fail(min(fault.axis, len(plant.axes)) - 1, fault.fault)
        elif isinstance(plant, ChamberPlant) and fault.fault in CHAMBER:
            if fault.fault == "stuck":
                plant.disturb(stuck=begins)
            elif fault.fault == "overshoot":
                plant.disturb(overshoot=fault.overshoot.value if begins else 0.0)
            elif begins:
                plant.alarm(3)
            else:
                plant.clear()

    def _pull(self, fault: Fault, begins: bool) -> None:
        if fault.fault == "unplug" and self.line is not None:
            if begins:
                self.line.port.unplug()
            else:
                self.line.port.plug()
        elif fault.fault == "refuse":
            port = self.messages[fault.instrument]
            if begins:
                port.refuse()
            else:
                self._returning = asyncio.get_running_loop().create_task(port.listen())

    # -- requests ------------------------------------------------------------------------------------------------------

    def declare(self, faults: Sequence[Fault]) -> list[int]:
        """Injects faults; returns their numbers."""
        return [self.board.declare(fault, self.live.now()) for fault in faults]

    def handle(self, request: Mapping[str, Json]) -> Mapping[str, Json]:
        """Handles one of the requests `{ask: bench}`, `{inject: FAULT}`, `{clear: NUMBER or all}`, `{ask: state}`, `{stop: true}`.
        Raises `ValueError` if the request is not valid."""
        if request.get("ask") == "bench":
            return {
                "speed": self.speed,
                "now": self.live.now(),
                "addresses": self.addresses,
                "roles": dict(self.simulated.roles),
            }
        if request.get("ask") == "state":
            return self.state()
        if "inject" in request:
            wanted = request["inject"]
            try:
                fault = read_fault(wanted if isinstance(wanted, str) else json.dumps(wanted), self.simulated.roles)
            except InputError as error:
                raise ValueError("; ".join(f"{item.message} ({item.hint})" for item in error.findings)) from None
            return {"fault": self.declare([fault])[0]}
        if "clear" in request:
            self.board.clear(None if request["clear"] == "all" else int(request["clear"]))
            return {"cleared": request["clear"]}
        if request.get("stop"):
            self.ended.set()
            return {"stopping": True}
        raise ValueError("a request must be one of ask, inject, clear and stop")

    def state(self) -> Mapping[str, Json]:
        """Returns the true present state, for tests of a run. The state contains joint angles and rates [rad, rad/s]; the
        temperature of the air, its target and the setpoint [K]; faults; and the counts of the serial line."""
        told: JsonObject = {"now": self.live.now(), "faults": self.board.told()}
        if self.live.table is not None:
            angles, rates = self.live.world.joints(self.live.now())
            told["table"] = {"angles": angles.tolist(), "rates": rates.tolist()}
        if self.live.chamber is not None:
            air = float(self.live.world.air(np.array([self.live.now()]))[0])
            target = self.live.world.command.target
            told["chamber"] = {"air": air, "target": target}
        for item in self.simulated.spoken:
            if isinstance(item.controller.plant, ChamberPlant):
                plant = item.controller.plant
                told["chamber"] |= {"running": plant.running, "setpoint": plant.setpoint}
            else:
                told["table"]["powered"] = [axis.powered for axis in item.controller.plant.axes]
        if self.line is not None:
            counts = self.line.counts
            told["line"] = asdict(counts)
        return told


def ready_note(serving: Serving) -> str:
    """Returns the content of the readiness file, as JSON. The content includes the token, so only users who can read the file can
    use the token."""
    control = f"{serving.control.host}:{serving.control.port}"
    note = {
        "pid": os.getpid(),
        "control": control,
        "token": serving.control.token,
        "speed": serving.speed,
        "addresses": serving.addresses,
    }
    return json.dumps(note, indent=1)
