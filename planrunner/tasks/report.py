"""Collects the data of a report from a run folder, its plan and bench, and the estimates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Literal

from planrunner.archive.recording import RecordedSegment, duration_of
from planrunner.archive.run_reader import RunReader
from planrunner.base.documents import Json
from planrunner.reporting import words
from planrunner.reporting.context import CertificateFacts, PrintedSignature, ReportContext, SegmentSummary
from planrunner.signing.key_ring import KeyRing
from planrunner.signing.run_signatures import SignatureStanding, bench_signing, signatures_of
from planrunner.tasks.approvals import approved_by

if TYPE_CHECKING:
    from planrunner.estimators.results import Results
    from planrunner.tasks.check import Sound

FILES = ("plan.yaml", "bench.yaml")


def report_context(
    reader: RunReader,
    sound: Sound,
    recording: Iterable[RecordedSegment],
    results: Results,
    *,
    analysis: str = "",
    analysed: str | None = None,
    certificate: CertificateFacts | None = None,
    amendment: str = "",
    ring: KeyRing | None = None,
) -> ReportContext:
    """Returns all data that a report shows for one analysis. `ring`: key ring with the keys that the user knows; it verifies the
    signatures of the run.

    `amendment`: a text that states who amends which analysis and why.

    `analysis`: number of the analysis, if known. `analysed`: time of the analysis, UTC in ISO 8601; by default, now.
    """
    segments = tuple(SegmentSummary.of(item) for item in recording)
    moment = analysed or datetime.now(UTC).isoformat(timespec="seconds")
    return ReportContext(
        title=sound.plan.title,
        description=" ".join(sound.plan.description.split()),
        run_information={
            "run": reader.run["run"],
            **{name: _text(value) for name, value in reader.run["info"].items()},
        },
        bench=_bench(sound),
        instruments={name: _identity(sound, name, said) for name, said in reader.instruments.items()},
        site=sound.models.site,
        segments=segments,
        estimates=tuple(results.estimates.values()),
        limits=tuple(results.limits),
        failures=results.failures,
        warnings=tuple(reader.warnings(len(sound.schedule.segments))),
        provenance=provenance(reader, analysis, moment, seeded=_seeded(sound)) | _approvals(reader),
        on_top=dict(_on_top(reader, segments, analysis)) | ({"amendment": amendment} if amendment else {}),
        origin=sound.models.origin,
        certificate=certificate,
        seal=reader.basis.seal or "",
        signatures=tuple(printed_signatures(reader, ring)),
    )


def printed_signatures(reader: RunReader, ring: KeyRing | None) -> Iterator[PrintedSignature]:
    """Returns the signatures of a run in their present state, for a report. Raises `OSError` if a signature cannot be read."""
    signing = bench_signing(reader.bench_bytes, reader.state.earlier_seals)
    for one in signatures_of(reader.folder, ring, signing):
        yield PrintedSignature(
            one.meaning, one.name, one.signed, one.key, one.analyses, _PRINTED[one.standing], one.owner, one.why
        )


_PRINTED: dict[SignatureStanding, Literal["valid", "unknown", "invalid"]] = {
    "valid": "valid",
    "unknown key": "unknown",
    "invalid": "invalid",
}


def _bench(sound: Sound) -> dict[str, str]:
    """Returns the bench as its file describes it, and the ambient conditions of the room if the file states any."""
    bench, room = sound.bench, sound.bench.ambient
    stated = (
        {} if room is None else {"temperature": room.temperature, "pressure": room.pressure, "humidity": room.humidity}
    )
    facts = {"name": bench.name, "description": " ".join(bench.description.split())}
    return facts | {f"ambient {name}": str(value) for name, value in stated.items() if value is not None}


def _identity(sound: Sound, name: str, said: Mapping[str, str]) -> dict[str, str]:
    """Returns the identity that an instrument reports, and the asset number of the instrument from the bench file."""
    entry = sound.bench.instruments.get(name)
    return {**said, "asset": entry.asset} if entry is not None and entry.asset else dict(said)


def _seeded(sound: Sound) -> bool:
    """Returns True if the seed of the run had an effect, that is, if this program simulated an instrument."""
    return sound.models.origin == "simulated" and sound.bench.simulation is None


def _on_top(reader: RunReader, segments: Sequence[SegmentSummary], analysis: str) -> Iterator[tuple[str, str]]:
    """Yields the facts at the top of a report. These facts are the item, the operator, the date, and the duration from the first
    sample to the last. The number of the analysis is added, with the number of analyses that existed when this analysis was
    made."""
    info = {name: _text(value) for name, value in reader.run["info"].items()}
    for name in ("device_serial", "item_identification"):
        if info.get(name):
            yield name, info[name]
    yield "operator", info.get("operator") or "not stated"
    began = str(reader.run["created"])
    ended = "" if reader.seal is None else str(reader.seal["sealed"])
    yield "run (UTC)", _minute(began) + (f" to {_minute(ended, began)}" if ended else ", not finished")
    lasted = duration_of(item.statistics for item in segments if item.statistics is not None)
    if lasted is not None:
        yield "duration of the measurements", words.duration(lasted)
    if reader.approvals is not None:
        yield "plan approved by", ", ".join(name for name, _ in approved_by(reader))
    if analysis:
        yield "analysis", f"{analysis} (of {max(int(analysis), len(reader.analyses))} when this report was written)"


def _approvals(reader: RunReader) -> dict[str, str]:
    """Returns the approvals under which the plan ran."""
    return {f"approval {number} of the plan": text for number, (_, text) in enumerate(approved_by(reader), 1)}


def _minute(moment: str, before: str = "") -> str:
    """Returns a time in ISO 8601 in the form `2026-03-01 08:11`. The date is omitted if the time `before` has the same date."""
    text = moment[:16].replace("T", " ")
    return text[11:] if before[:10] == moment[:10] else text


def provenance(reader: RunReader, analysis: str, analysed: str, *, seeded: bool = True) -> dict[str, str]:
    """Returns the origin of the results: times, digests and versions of the run. The corresponding values of the analysis are added
    if they differ from the values of the run. `seeded`: True if the seed of the run had an effect."""
    from planrunner.archive.provenance import versions

    facts = {"analysis": analysis} if analysis else {}
    facts |= {"recording started (UTC)": str(reader.run["created"]), "analysed (UTC)": analysed}
    if reader.seal is not None:
        facts["sealed (UTC)"] = str(reader.seal["sealed"])
        facts["seal.json (SHA-256)"] = str(reader.basis.seal)
        facts["journal head (SHA-256)"] = str(reader.seal["journal"]["head"])
    digests = reader.state.created.get("files", {})
    facts |= {f"{name} (SHA-256)": str(digests[name]) for name in FILES if name in digests}
    if seeded and reader.run["seed"] is not None:
        facts["seed of simulated noise"] = str(reader.run["seed"])
    ran, now = reader.run["versions"], versions()
    for name in {**ran, **now}:
        first, second = ran.get(name, "none"), now.get(name, "none")
        facts[name] = first if first == second else f"{first} when run, {second} when analysed"
    return facts


def _text(value: Json) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {_text(item)}" for name, item in value.items())
    return str(value)
