"""Defines the interface of the simulator of an instrument. A simulator is found in the entry-point group `planrunner.simulators`,
under the name of the instrument's driver.

For a table or a chamber, it is a function that returns a `Conversation`. For a sensor, it is a function that returns the
`SensorUnit` at the end of the line. Both functions receive the driver's keys in the bench file and the virtual bench; the function
for a sensor also receives the feed of its samples. Simulators share no code with drivers. A simulator declares the keys that it
reads, as a protocol.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from planrunner.plan.kinds import Record
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.live_world import LiveWorld, SensorFeed
from planrunner.simulators.message_port import Controller, Manner
from planrunner.simulators.sensor_units import SensorUnit
from planrunner.simulators.table_plant import TablePlant


class PlantController(Controller, Protocol):
    """The controller of a simulated table or chamber."""

    @property
    def plant(self) -> TablePlant | ChamberPlant: ...


@dataclass(frozen=True, slots=True)
class Conversation:
    """A simulated table or chamber, which exchanges messages. `framed`: True if the replies over TCP are framed in the way that the
    key `simulation` of the bench states."""

    controller: PlantController
    manner: Manner = field(default_factory=Manner)
    framed: bool = False


ConversationSimulator = Callable[[Record, LiveWorld], Conversation]
SensorSimulator = Callable[[Record, LiveWorld, SensorFeed], SensorUnit]
