"""Interface of a simulator of an instrument. It is found under the name of the instrument's driver in the entry-point group
`planrunner.simulators`.

For a table or a chamber it is a function that returns a `Conversation`. For a sensor it is a function that returns the `SensorUnit`
on its line. Both functions receive the driver's keys in the bench file and the virtual bench; a sensor also receives the feed of
its samples. Simulators share no code with drivers. A simulator declares, as a protocol, the keys that it reads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from planrunner.plan.kinds import Record
from planrunner.simulators.chamber_plant import ChamberPlant
from planrunner.simulators.conversation import Controller
from planrunner.simulators.live_world import LiveWorld, SensorFeed
from planrunner.simulators.message_port import Manner
from planrunner.simulators.sensor_units import SensorUnit
from planrunner.simulators.table_plant import TablePlant


class PlantController(Controller, Protocol):
    """A controller of a table or a chamber."""

    @property
    def plant(self) -> TablePlant | ChamberPlant: ...


@dataclass(frozen=True, slots=True)
class Conversation:
    """A table or chamber that answers messages. framed: over TCP, replies have the framing that the bench's `simulation` states."""

    controller: PlantController
    manner: Manner = field(default_factory=Manner)
    framed: bool = False


ConversationSimulator = Callable[[Record, LiveWorld], Conversation]
SensorSimulator = Callable[[Record, LiveWorld, SensorFeed], SensorUnit]
