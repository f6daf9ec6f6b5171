"""Addresses as bench files write them, told apart by what a simulator has to open for them; only this computer is served."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from planrunner.simulators.ports import PortError

_VISA_SOCKET = re.compile(r"(TCPIP\d*::)([^:]+)::(\d+)(::SOCKET)", re.IGNORECASE)
_URL = re.compile(r"((?:ASRL)?socket://)([^:/]+):(\d+)((?:::INSTR)?)", re.IGNORECASE)
_VISA_SERIAL = re.compile(r"(ASRL)(.*?)((?:::INSTR)?)", re.IGNORECASE)
_HERE = ("127.0.0.1", "localhost")


@dataclass(frozen=True, slots=True)
class Address:
    """host, port: of a TCP address; link: the name of a pseudo-terminal, None for TCP. before, after: what is written around."""

    before: str
    after: str
    host: str = ""
    port: int = 0
    link: Path | None = None

    @classmethod
    def of(cls, text: str) -> Address:
        """Raises `PortError` for an address that cannot be simulated."""
        for form, between in ((_VISA_SOCKET, "::"), (_URL, ":")):
            if found := form.fullmatch(text):
                if found[2].lower() not in _HERE:
                    message = f"{text} is on another computer; a simulated bench is on loopback"
                    raise PortError(f"{message}: write 127.0.0.1 in place of {found[2]}")
                return cls(found[1] + found[2] + between, found[4], found[2], int(found[3]))
        if re.match(r"(GPIB|USB|TCPIP|VXI|PXI)\d*::", text, re.IGNORECASE):
            raise PortError(
                f"{text} cannot be simulated: use TCPIP::127.0.0.1::PORT::SOCKET, or ASRL and the name of a port"
            )
        found = _VISA_SERIAL.fullmatch(text) if text.upper().startswith("ASRL") else None
        before, name, after = (found[1], found[2], found[3]) if found else ("", text, "")
        return cls(before, after, link=Path(name))

    def elsewhere(self, folder: Path, name: str) -> Address:
        """A free port, or a link of an instrument's name in a folder, in its place."""
        link = None if self.link is None else folder / f"{name}.port"
        return Address(self.before, self.after, self.host, 0, link)

    def written(self, port: int | None = None) -> str:
        """As in a bench file; `port` where it was chosen by the system."""
        return f"{self.before}{self.link or port or self.port}{self.after}"
