"""Determines the contents of the calibration certificate of a run, and the reasons that prevent issuing it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from datetime import UTC, date, datetime

from planrunner.archive.analyses import StoredAnalysis
from planrunner.archive.recording import RecordedSegment, duration_of
from planrunner.archive.run_reader import RunReader
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Finding, Findings, Mark, closest
from planrunner.base.said import Said
from planrunner.bench.model import AmbientSpec
from planrunner.estimators.interface import Estimate
from planrunner.estimators.results import Results
from planrunner.plan.units import ZERO_CELSIUS
from planrunner.reporting.certificate import named_in
from planrunner.reporting.certificate_names import CHAMBER_TEMPERATURE, of_reference, of_room
from planrunner.reporting.certificate_requirements import (
    ASKED,
    DATES,
    Reference,
    is_certificate,
    lacks_of_bench,
    lacks_of_information,
    references,
    room_condition,
)
from planrunner.reporting.context import CertificateFacts, Traced
from planrunner.tasks.approvals import approved_by
from planrunner.tasks.check import Sound

ISSUED = "issued.json"  # stored with a certificate: its number, and the certificate that it amends


def facts(
    reader: RunReader,
    sound: Sound,
    recording: Iterable[RecordedSegment],
    given: Mapping[str, str],
    before: Mapping[str, Estimate] | None = None,
    before_run: str = "",
) -> CertificateFacts:
    """Returns the contents of a certificate for this run. `given`: run information that is given when the certificate is issued;
    it takes precedence over the information in the run. `before`: maps the name of each estimate to its result before the item
    was adjusted. `before_run`: name of the run with these results."""
    recorded = recorded_information(reader)
    segments = tuple(recording)
    bench = sound.bench
    laboratory = bench.laboratory
    stated = {} if laboratory is None else {name: getattr(laboratory, name) for name in _SHOWN}
    told = recorded | dict(given)
    return CertificateFacts(
        run=reader.run["run"],
        laboratory={name: text for name, text in stated.items() if text},
        told=told,
        corrected={name: text for name, text in recorded.items() if told[name] != text},
        references=tuple(_traced(item, reader.instruments.get(item.name, {})) for item in references(bench)),
        conditions=tuple(_conditions(sound, segments, told)),
        events=tuple(_events(reader)),
        performed=(_day(reader.run["created"]), _day(reader.seal["sealed"]) if reader.seal else ""),
        issued=told.get("date_issued") or datetime.now(UTC).date().isoformat(),
        plan_digest=str(reader.state.created["files"]["plan.yaml"]),
        approvals=tuple(text for _, text in approved_by(reader)),
        before=dict(before or {}),
        before_run=before_run,
        duration=duration_of(item.statistics for item in segments),
        simulated=sound.models.origin == "simulated",
        replayed=sound.models.replays,
    )


_SHOWN = ("name", "address", "location", "contact", "accreditation", "traceability")


def recorded_information(reader: RunReader) -> dict[str, str]:
    """Returns the run information that is stored in the run folder."""
    return {name: str(value) for name, value in reader.run["info"].items()}


def _day(moment: object) -> str:
    return str(moment)[:10]


def _traced(item: Reference, said: Mapping[str, str]) -> Traced:
    identity = ", ".join(text for text in (*said.values(), item.asset) if text)
    found, name = item.calibration, of_reference(item.name, item.role)
    if found is None:
        return Traced(name, identity)
    return Traced(name, identity, found.certificate, found.date, found.due or "", found.laboratory or "")


def _conditions(
    sound: Sound, recording: tuple[RecordedSegment, ...], told: Mapping[str, str]
) -> Iterable[tuple[Said, str]]:
    room = sound.bench.ambient or AmbientSpec()
    declared = {"temperature": room.temperature, "pressure": room.pressure, "humidity": room.humidity}
    stated = {condition: text for name, text in told.items() if (condition := room_condition(name))}
    for condition in dict.fromkeys((*declared, *stated)):
        if value := stated.get(condition) or declared.get(condition):
            yield of_room(condition), str(value)
    held = [item.segment.temperature for item in recording if item.segment.temperature is not None]
    if held:
        yield CHAMBER_TEMPERATURE, _range([kelvin - ZERO_CELSIUS for kelvin in held], " °C")
    tables = tuple(f"{item.name}." for item in references(sound.bench) if item.role == "table")
    for name in {name: None for item in recording for name in item.readings if not name.startswith(tables)}:
        read, _, unit = name.rpartition("_")
        values = [item.readings[name] for item in recording if math.isfinite(item.readings.get(name, math.nan))]
        if values:
            in_words = (read, " " + _UNITS[unit]) if unit in _UNITS else (name, "")
            yield Said(in_words[0]), _range(values, in_words[1])


_UNITS = {"degC": "°C", "K": "K", "Pa": "Pa", "hPa": "hPa", "kPa": "kPa", "percent": "%", "V": "V", "A": "A"}


def _range(values: list[float], unit: str) -> str:
    low, high = f"{round(min(values), 3):g}", f"{round(max(values), 3):g}"
    return f"{low}{unit}" if low == high else f"{low}{unit} … {high}{unit}"


def _events(reader: RunReader) -> Iterable[tuple[str, str, str]]:
    for text in reader.state.failures:
        yield "fault", "", text
    for item in reader.acknowledged():
        if item.truncated:
            yield "truncated", item.label, item.reason or ""
    for other in reader.rejected():
        yield "rejected", other.label, other.reason or ""


def obstacles(reader: RunReader, sound: Sound, results: Results, shown: CertificateFacts) -> list[Finding]:
    """Returns all reasons that prevent issuing a certificate for this run."""
    log = Findings()
    mark = Mark(str(reader.path))
    told = {name for name, text in shown.told.items() if text}
    held = any(segment.temperature is not None for segment in sound.schedule.segments)
    lacks = lacks_of_information(told, "give --set {name}=…, or write it in a file for --info")
    for lack in [*lacks_of_bench(sound.bench, told, held), *lacks]:
        log.error("report-certificate-missing", mark, str(lack), lack.remedy)
    _check_dates(shown, mark, log)
    _check_who(sound, shown, mark, log)
    _check_estimates(sound, shown, mark, log)
    _check_amendment(reader, shown, mark, log)
    if not reader.sealed or len(reader.acknowledged()) < len(sound.schedule.segments):
        message = "the run is not finished and sealed, so its results can still change"
        log.error("report-certificate-incomplete", mark, message, "finish it with planrunner resume")
    for name, why in results.failures.items():
        message = f"'{name}' could not be made: {why}"
        log.error(
            "report-certificate-incomplete", mark, message, "remove it from the plan or correct it, and run again"
        )
    return list(log)


def _check_dates(shown: CertificateFacts, mark: Mark, log: Findings) -> None:
    days = {name: shown.told[name] for name in DATES if shown.told.get(name)}
    for name, text in days.items():
        try:
            day = date.fromisoformat(text)
        except ValueError:
            day = None
        if day is None or day.isoformat() != text:
            log.error("report-certificate-date", mark, f"'{name}' is '{text[:40]}'", "write it as 2026-03-01")
            return
    first, last = shown.performed
    if days.get("date_received", first) > first:
        message = f"the date of receipt, {days['date_received']}, is after the beginning of the calibration on {first}"
        log.error("report-certificate-date", mark, message, "correct date_received")
    if shown.issued < (last or first):
        message = f"the date of issue, {shown.issued}, is before the end of the calibration on {last or first}"
        log.error("report-certificate-date", mark, message, "correct date_issued")


def _check_who(sound: Sound, shown: CertificateFacts, mark: Mark, log: Findings) -> None:
    may = sound.bench.laboratory.authorised if sound.bench.laboratory else ()
    who = shown.told.get("issued_by", "")
    if may and who and not any(one in who for one in may):
        message = f"'{who[:80]}' may not authorise certificates of this laboratory"
        log.error("report-certificate-authority", mark, message, f"set issued_by to one of: {', '.join(may)}")


def _check_estimates(sound: Sound, shown: CertificateFacts, mark: Mark, log: Findings) -> None:
    for name in ("certified_estimates", "external_estimates"):
        for unknown in sorted(named_in(shown.told, name) - set(sound.plan.estimates)):
            message = f"{name} names '{unknown[:40]}', which is not an estimate of this plan"
            log.error("report-certificate-estimates", mark, message, closest(unknown, sound.plan.estimates))
    if bool(shown.told.get("external_estimates")) != bool(shown.told.get("external_provider")):
        message = "results from an external provider need both external_estimates and external_provider"
        log.error("report-certificate-estimates", mark, message, "give both, or neither")


def _check_amendment(reader: RunReader, shown: CertificateFacts, mark: Mark, log: Findings) -> None:
    """Checks ISO/IEC 17025, 7.8.8: only a new certificate with a different number may replace an issued certificate. The new
    certificate must name the replaced certificate and the reason."""
    told = shown.told
    earlier = [one for one in reader.analyses if any(map(is_certificate, one.files))]
    numbers = [_number_of(one) for one in earlier]
    amends, own = told.get("amends"), told.get("certificate_number")
    if earlier and not amends:
        message = f"a certificate of this run has already been issued, in analysis {', '.join(str(one.number) for one in earlier)}"
        hint = "to issue another one, give amends (the number of the earlier one), amendment_reason and a new certificate_number"
        log.error("report-certificate-amendment", mark, message, hint)
    elif amends and not told.get("amendment_reason"):
        log.error("report-certificate-amendment", mark, "an amendment needs a reason", "give amendment_reason")
    elif amends and own in (amends, *numbers):
        message = f"'{str(own)[:40]}' is the number of a certificate that has already been issued"
        log.error("report-certificate-amendment", mark, message, "give a new certificate_number")
    elif amends and amends not in numbers and None not in numbers:
        message = f"no certificate '{amends[:40]}' has been issued for this run"
        hint = (
            f"issued so far: {', '.join(map(str, numbers))}"
            if numbers
            else "leave amends out: this is the first certificate"
        )
        log.error("report-certificate-amendment", mark, message, hint)


def issued_as(shown: CertificateFacts) -> JsonObject:
    """Returns the data that are stored with a certificate, so that later certificates can be checked against them."""
    kept = {name: shown.told.get(name, "") for name in ("certificate_number", "amends", "amendment_reason")}
    return {"planrunner_issued": 1, **{name: text for name, text in kept.items() if text}, "issued": shown.issued}


def _number_of(analysis: StoredAnalysis) -> str | None:
    """Returns the number of the certificate that was issued with an analysis; None if no number was stored. Raises `IntegrityError`
    if the stored data were changed."""
    if ISSUED not in analysis.files:
        return None
    number = analysis.read_json(ISSUED, "issued", "planrunner_issued", 1).get("certificate_number")
    return None if number is None else str(number)


def not_before(shown: CertificateFacts, certified: RunReader, reader: RunReader) -> list[Finding]:
    """Returns the reason why a run cannot serve as the run before the adjustment: it may be the certified run itself, or a run of
    another item. Returns an empty list if neither is the case."""
    if (reader.run["run"], reader.run["created"]) == (certified.run["run"], certified.run["created"]):
        message = "this is the run to be certified; it cannot also be the run before the adjustment"
        hint = "give the run of the same item before its adjustment"
        return [Finding(Mark(str(reader.path)), "report-certificate-before", "error", message, hint)]
    earlier = recorded_information(reader)
    for name in ("device_serial", "item_identification"):
        now = shown.told.get(name)
        if now and earlier.get(name) and earlier[name] != now:
            message = f"its {name} is '{earlier[name][:40]}', but the {name} of this run is '{now[:40]}'"
            hint = "give the run of the same item before its adjustment"
            return [Finding(Mark(str(reader.path)), "report-certificate-before", "error", message, hint)]
    return []


def names() -> list[str]:
    """Returns the names of all items of run information that certificates use."""
    return [item.name for item in ASKED]
