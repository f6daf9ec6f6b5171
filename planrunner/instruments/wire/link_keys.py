"""Keys of a bench file that say how an instrument on a message link is reached and known again."""

from __future__ import annotations

from planrunner.instruments.interfaces import InstrumentError
from planrunner.plan.kinds import Number, QuantityOf, Record, Text, key
from planrunner.plan.quantity import Quantity, parse_quantity

RESOURCE = (
    r"(GPIB\d*::\d+(::\d+)?::INSTR|TCPIP\d*::[^:\s]+::\d+::SOCKET|TCPIP\d*::[^:\s]+(::[^:\s]+)?::INSTR"
    r"|USB\d*::\S+::INSTR|ASRL\S+::INSTR)"
)


class LinkKeys(Record):
    """How an instrument is reached."""

    address: str = key(
        Text(
            RESOURCE, "a VISA resource name such as TCPIP::192.168.0.5::5025::SOCKET, GPIB0::3::INSTR or ASRL3::INSTR"
        ),
        "VISA resource name: network address and port, GPIB address or serial port.",
        "TCPIP::192.168.0.5::5025::SOCKET",
    )
    timeout: Quantity = key(
        QuantityOf("time", "positive"),
        "Longest time until the instrument answers.",
        "2 s",
        default=parse_quantity("2 s"),
    )
    baud: int = key(
        Number(50, 4_000_000, integer=True), "Bit rate of a serial line, in bits per second.", 9600, default=9600
    )
    model_contains: str | None = key(
        Text(r"\S.{0,60}", "some text"),
        "Text that the identification of the instrument must contain, in upper or lower case; by default the text "
        "that the driver expects.",
        "ACUTROL",
        default=None,
    )

    def check_identity(self, said: str, expected: str) -> None:
        """Raises `InstrumentError` unless the instrument is one that the driver, or the bench file, expects at this address."""
        wanted = self.model_contains or expected
        if wanted.casefold() not in said.casefold():
            raise InstrumentError(
                f"{self.address} says that it is '{said[:80]}', which does not contain '{wanted}': check the address, "
                "or set "
                "model_contains in the bench file if this is the right instrument"
            )
