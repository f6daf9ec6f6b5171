"""Verifies the time stamps of a run. Determines the data that each stamp covers and the certificate that verifies it, and checks
that the times in the journal agree with the stamps.

A time stamp proves that the stamped events existed at the time of the stamp. A later event `stamped` contains the digest of the
stamp, so this event and all following events were written after the stamp. The times of events between two stamps therefore have a
lower and an upper bound.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

from planrunner.archive import seal as seals
from planrunner.archive.journal import NAME as JOURNAL
from planrunner.archive.stamp_files import DIGITS, FOLDER, MOST_BYTES, StampName, stamp_names
from planrunner.archive.storage import ASIDE, digest
from planrunner.archive.verifying import BENCH, CLOCKS_DIFFER, Examined
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import Mark
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.signing.declared import declared
from planrunner.signing.time_stamps import StampAuthority, StampError, parse_authority, stamp_time, stamped_digest

LATE = timedelta(hours=1)
"""Largest accepted delay between the stated time of a seal and its time stamp. A longer delay is reported."""

StampStanding = Literal["valid", "unknown authority", "invalid"]


@dataclass(frozen=True, slots=True)
class RunStamp:
    """One time stamp of a run.

    `events`: number of events in the stamped part of the journal; None for a stamp of the seal. `time`: the time that the authority
    states, UTC, ISO 8601; empty if it cannot be read. `standing`: the result of the check. `standing` is `unknown authority` if
    only the certificate in the bench file of the run verifies the stamp. `why`: the reason why the stamp is not valid; empty if it
    is valid.
    """

    file: str
    events: int | None
    time: str
    standing: StampStanding
    why: str = ""

    def to_json(self) -> JsonObject:
        return {name: getattr(self, name) for name in self.__slots__}


def declared_stamps(found: Examined) -> Mapping[str, Json] | None:
    """Returns the value of the key `time_stamps` in the bench file of a run, without validation; None if there is none, or if the
    file cannot be read."""
    told = declared(found.given.get(BENCH), "time_stamps")
    return told if isinstance(told, dict) else None


def stamped_seals(folder: GuardedFolder) -> set[str]:
    """Returns the digests of all seals that were stamped, according to the time stamps in a run folder. Raises `OSError` if a stamp
    cannot be read."""
    found = set()
    for name in stamp_names(folder):
        if name.own is not None:
            with contextlib.suppress(StampError):
                found.add(stamped_digest(folder.folder(FOLDER).read(name.file, MOST_BYTES)))
    return found


def verify_stamps(found: Examined, given: StampAuthority | None) -> tuple[RunStamp, ...]:
    """Verifies all time stamps of an examined run. Adds faults to the findings of `found`. `given`: the authority that the verifier
    trusts. Raises `OSError` if a file cannot be read."""
    mark, stated = Mark(str(found.folder.path)), declared_stamps(found)
    own = _stated_authority(stated)
    authority = given or own
    names = stamp_names(found.folder)
    _check_files(found, names)
    stamps = tuple(_verified(found, name, authority, known=given is not None) for name in names)
    if found.state is None or found.scan is None:
        return stamps
    _check_record(found, {one.file: one for one in stamps})
    if stated is not None:
        for number in found.state.unstamped_ends:
            place = f"{found.folder.path / JOURNAL}:{number}"
            found.error("run-stamp-missing", f"{place}: the run ends without the time stamp that its bench requires")
        _check_seal(found, stamps)
    if stamps and given is None:
        message = "the time stamps are verified only with the certificate in the bench file of the run"
        found.findings.warning(
            "run-stamp-unverified", mark, message, "give the certificate of the authority with --authority"
        )
    for event in found.state.unstamped:
        message = f"no time stamp of the journal at event {event['events']}: {event['reason']}"
        found.findings.warning(
            "run-unstamped", mark, message, "the times of these events are those of the computer only"
        )
    return stamps


def _stated_authority(stated: Mapping[str, Json] | None) -> StampAuthority | None:
    try:
        return None if stated is None else parse_authority(str(stated.get("certificate", "")).encode())
    except ValueError:
        return None


def _check_files(found: Examined, names: tuple[StampName, ...]) -> None:
    """Reports entries of the folder `stamps` that are not time stamps, and gaps in the numbers of the stamps."""
    if found.folder.entry(FOLDER) is None:
        return
    within, known = found.folder.folder(FOLDER), {one.file for one in names}
    for name, entry in within.entries().items():
        if entry.kind != "file" or (name not in known and not name.endswith(ASIDE)):
            found.error("run-unknown-file", f"{within.path / name}: {entry.what} that is not a time stamp")
    if [one.number for one in names] != list(range(1, len(names) + 1)):
        message = "the time stamps are not numbered from 1 without gaps: one was removed or added"
        found.error("run-stamp-missing", f"{within.path}: {message}")


def _verified(found: Examined, name: StampName, authority: StampAuthority | None, *, known: bool) -> RunStamp:
    path = found.folder.path / FOLDER / name.file
    at, why, code = "", "", "run-stamp"
    try:
        token = found.folder.folder(FOLDER).read(name.file, MOST_BYTES)
        stamped = stamped_digest(token)
        if name.own is not None and digest(token)[:DIGITS] != name.own:
            why = "the file was changed or renamed"
        else:
            code, why = _subject_fault(found, name, stamped)
        if not why and authority is None:
            why = "there is no certificate to verify it with"
            return RunStamp(name.file, name.events, at, "unknown authority", why)
        if authority is not None:
            moment = stamp_time(token, stamped, authority)
            at = moment.isoformat()
            if not why:
                code, why = _time_fault(found, name, moment)
    except (OSError, StampError) as error:
        code, why = "run-stamp", str(error)
    if why:
        found.error(code, f"{path}: {why}")
        return RunStamp(name.file, name.events, at, "invalid", why)
    return RunStamp(name.file, name.events, at, "valid" if known else "unknown authority")


def _subject_fault(found: Examined, name: StampName, stamped: str) -> tuple[str, str]:
    """Returns the fault of a stamp that belongs neither to the present journal nor to a seal of the run, as a code and a message.
    The code and the message are empty if there is no fault."""
    if found.scan is None or found.state is None:
        return "", ""
    if name.events is None:
        if stamped not in {found.seal_digest, *found.state.earlier_seals}:
            return "run-stamp", f"it stamps a seal other than {seals.NAME}"
    elif name.events > found.scan.count:
        message = f"it stamps {name.events} events, but the journal has {found.scan.count}: the journal was cut"
        return "run-cut-short", message
    elif found.scan.heads.get(name.events) != stamped:
        return "run-stamp", f"it stamps another journal: the first {name.events} events were changed"
    return "", ""


def _time_fault(found: Examined, name: StampName, moment: datetime) -> tuple[str, str]:
    """Returns the fault of a stamp that is earlier than a time in the stamped data, as a code and a message. The code and the
    message are empty if there is no fault."""
    if found.scan is None:
        return "", ""
    stated = found.scan.times.get(name.events) if name.events is not None else None
    if name.events is None and found.seal is not None:
        stated = found.seal["sealed"]
    if stated is not None and datetime.fromisoformat(stated) > moment + CLOCKS_DIFFER:
        return "run-back-dated", f"it was made on {moment.isoformat()}, but the stamped data are dated {stated}"
    return "", ""


def _check_record(found: Examined, stamps: Mapping[str, RunStamp]) -> None:
    """Checks that all stamps that the journal names exist and are unchanged. Also checks that an event that records a stamp is not
    earlier than the stamp."""
    assert found.state is not None
    for event in found.state.stamped:
        path, place = found.folder.path / FOLDER / event["file"], f"{found.folder.path / JOURNAL}:{event['seq']}"
        stamp = stamps.get(event["file"])
        if stamp is None:
            found.error("run-stamp-missing", f"{path}: this time stamp is in the journal, but it is missing")
            continue
        try:
            same = digest(found.folder.folder(FOLDER).read(event["file"], MOST_BYTES)) == event["sha256"]
        except OSError:
            same = False
        if not same or stamp.events != event["events"]:
            found.error("run-stamp", f"{path}: this is not the time stamp in the journal")
        elif stamp.time:
            moment = datetime.fromisoformat(stamp.time)
            if datetime.fromisoformat(event["at"]) < moment - CLOCKS_DIFFER:
                message = f"dated {event['at']}, but it contains a time stamp of {stamp.time}: it was written later"
                found.error("run-back-dated", f"{place}: {message}")


def _check_seal(found: Examined, stamps: tuple[RunStamp, ...]) -> None:
    """Checks that the present seal has a time stamp, and that this stamp was obtained in time."""
    assert found.state is not None
    mark = Mark(str(found.folder.path))
    if found.seal is None or not found.state.finished:
        return
    times = [one.time for one in stamps if one.events is None and one.standing != "invalid" and one.time]
    last = datetime.fromisoformat(times[-1]) if times else None
    sealed = datetime.fromisoformat(found.seal["sealed"])
    if last is None or last < sealed - CLOCKS_DIFFER:
        hint = f"`planrunner stamp {found.folder.path}` tries again"
        message = "the seal has no time stamp, although the bench requires one"
        found.findings.warning("run-seal-unstamped", mark, message, hint)
    elif min(map(datetime.fromisoformat, times), key=lambda one: abs(one - sealed)) > sealed + LATE:
        message = f"the seal states {found.seal['sealed']}, but it was stamped only on {times[-1]}"
        found.findings.warning(
            "run-stamped-late", mark, message, "find out why: an outage of the authority, or a seal made later"
        )
