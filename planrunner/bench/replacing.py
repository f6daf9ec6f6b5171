"""Checks whether a bench file may replace the bench file with which a run began: only the addresses of instruments may differ."""

from __future__ import annotations

from planrunner.base.documents import Json
from planrunner.bench.model import Bench, driver_of, real_instruments
from planrunner.instruments.interfaces import Addressed
from planrunner.plan import source

REACHED_BY = ("address", "port", "baud", "timeout")
"""Keys of an instrument that describe its connection. They may differ between computers, and results do not depend on them."""


def other_than_reached(first: bytes, second: bytes, shown: tuple[str, str]) -> list[str]:
    """Returns the keys in which two bench files differ, such as instruments.table.axes. The addresses of instruments are not
    compared. `shown`: names of the two files, for messages. Raises `InputError` for a file that cannot be read."""
    one, other = (
        source.plain(source.parse(source.decode(data, name), name))
        for data, name in zip((first, second), shown, strict=True)
    )
    return [".".join(place) for place in _differences(one, other, ()) if not _reaches(place)]


def addresses(bench: Bench) -> dict[str, str]:
    """Maps the name of each real instrument that has an address to this address."""
    found = {}
    for name in real_instruments(bench):
        driver, parameters = driver_of(bench.instruments[name]), bench.instruments[name].parameters
        if issubclass(driver, Addressed):
            found[name] = str(driver.address(parameters))
    return found


def _differences(one: Json, other: Json, place: tuple[str, ...]) -> list[tuple[str, ...]]:
    if isinstance(one, dict) and isinstance(other, dict):
        names = list(dict.fromkeys([*one, *other]))
        return [
            found
            for name in names
            for found in (
                _differences(one[name], other[name], (*place, name))
                if name in one and name in other
                else [(*place, name)]
            )
        ]
    return [] if one == other and type(one) is type(other) else [place]


def _reaches(place: tuple[str, ...]) -> bool:
    return place == ("description",) or (len(place) == 3 and place[0] == "instruments" and place[2] in REACHED_BY)
