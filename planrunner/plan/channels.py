"""Channels that estimates name, held against those that the bench's sensor has.

Every parameter of the kind `CHANNEL` is found by its declaration, so that estimators of plug-ins are held to the same.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

from planrunner.base.findings import Findings, closest
from planrunner.plan.kinds import CHANNEL, ListOf, Record, keys_of


def check_channels(parameters: Record, outputs: Collection[str] | None, log: Findings) -> None:
    """Findings about channels that the sensor does not have or that are named twice.

    outputs: of the sensor; None where it is not known what will be recorded. Channels that a plan does not name itself, an estimator's
    defaults, may be missing: the estimator knows whether it can do without them.
    """
    seen: set[str] = set()
    for key, place, channel in _named(parameters):
        given = key in parameters.origin.keys
        mark = parameters.at(place)
        if channel in seen:
            hint = "give each axis and each purpose a different channel"
            log.error("meaning-channel-twice", mark, f"'{channel[:60]}' is named twice", hint)
        elif given and outputs is not None and channel not in outputs:
            message = f"{key}: the sensor of this bench has no output '{channel[:60]}'"
            log.error("meaning-sensor-output", mark, message, closest(channel, outputs))
        seen.add(channel)


def channels_of(parameters: Record) -> tuple[str, ...]:
    """The channels that parameters name, their defaults included."""
    return tuple(dict.fromkeys(channel for _, _, channel in _named(parameters)))


def _named(parameters: Record) -> Iterator[tuple[str, str, str]]:
    """Key, place in the file and channel."""
    for key, item in keys_of(type(parameters)).items():
        kind, value = item.metadata["kind"], getattr(parameters, item.name)
        if isinstance(kind, ListOf) and kind.item == CHANNEL:
            for k, channel in enumerate(value):
                yield key, f"{key}[{k}]", channel
        elif kind == CHANNEL and value is not None:
            yield key, key, value
