"""Collects the run information that a plan requests (serial number, operator, ambient conditions …). The user gives this
information with `--set` or in a file."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from planrunner.base.findings import COMMAND_LINE, MISLEADING, Findings, InputError, Mark, closest, nearest
from planrunner.plan import source
from planrunner.plan.model import Plan

DEVICE = ("device_serial", "item_identification")
"""Items of the run information that name the device. If several are given, the first one counts."""


def device_of(info: Mapping[str, object]) -> str:
    """Returns the name of the device in the run information; empty if no device is stated."""
    return next((str(info[name]) for name in DEVICE if info.get(name)), "")


def gather(plan: Plan, settings: Sequence[str], file: Path | None) -> dict[str, str]:
    """Returns all run information that the user gives; `--set name=value` takes precedence over the file. Raises `InputError` for
    missing, unknown or unreadable items."""
    log = Findings()
    given = _read(settings, file, log)
    _check(plan.record, "add it under record: in the plan", given, log)
    # Items without a value or with a misspelt name have already been reported as missing.
    attempted = {setting.partition("=")[0].strip() for setting in settings}
    meant = attempted | {nearest(name, plan.record) for name in (*given, *attempted) if name not in plan.record}
    for name, item in plan.record.items():
        if item.required and name not in given and name not in meant:
            hint = f"give --set {name}=…, or write it in a file for --info"
            log.error("run-info-missing", item.mark, f"the plan requires '{name}'", hint)
    if log.errors:
        raise InputError(log)
    return {name: given[name][0] for name in plan.record if name in given}


def gather_for_issue(names: Collection[str], settings: Sequence[str], file: Path | None) -> dict[str, str]:
    """Returns the run information that the user gives when a report is issued after the run. `names`: the permitted items. Raises
    `InputError` for an item that is unknown or unreadable."""
    log = Findings()
    given = _read(settings, file, log)
    _check(names, "docs/certificates.md lists the names that a certificate uses", given, log)
    if log.errors:
        raise InputError(log)
    return {name: value for name, (value, _) in given.items()}


def _read(settings: Sequence[str], file: Path | None, log: Findings) -> dict[str, tuple[str, Mark]]:
    given: dict[str, tuple[str, Mark]] = {}
    if file is not None:
        for key, node in source.load(file).entries:
            if isinstance(node, source.Scalar) and node.value is not None:
                given[key.text] = (node.text, key.mark)
            else:
                log.error("run-info-value", node.mark, f"'{key.text[:40]}' needs one value", "write name: value")
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or not value.strip():
            log.error(
                "run-info-value",
                COMMAND_LINE,
                f"--set {setting[:60]} gives no value",
                f"write --set {name.strip()[:40] or 'name'}=… with the value after the '='",
            )
        else:
            given[name.strip()] = (value.strip(), COMMAND_LINE)
    return given


def _check(names: Collection[str], hint: str, given: Mapping[str, tuple[str, Mark]], log: Findings) -> None:
    for name, (value, mark) in given.items():
        if name not in names:
            message = f"the plan does not ask for '{name[:40]}'"
            log.error("run-info-unknown", mark, message, closest(name, names) or hint)
        elif len(value) > 500 or re.search(r"[\x00-\x1f\x7f]", value):
            log.error("run-info-value", mark, f"'{name}' must be one line of at most 500 characters", "shorten it")
        elif hidden := MISLEADING.search(value):
            message = f"'{name}' holds the character U+{ord(hidden[0]):04X}, which is invisible and changes the reading order of the others"
            log.error("run-info-value", mark, message, "type it again without that character")
