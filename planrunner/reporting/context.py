"""Defines the input of reports: plain records that do not depend on instruments or estimators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from planrunner.archive.recording import RecordedSegment, Statistics
from planrunner.base.said import Said
from planrunner.estimators.interface import Estimate
from planrunner.estimators.limits import LimitVerdict
from planrunner.instruments.models import DataOrigin
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Segment
from planrunner.reporting.verdict import Headline, headline


@dataclass(frozen=True, slots=True)
class Traced:
    """Describes a reference to which the results are traceable: the site or an instrument, with the instrument's description of
    itself and the stated calibration."""

    name: Said
    identity: str = ""
    certificate: str = ""
    date: str = ""
    due: str = ""
    laboratory: str = ""


@dataclass(frozen=True, slots=True)
class PrintedSignature:
    """Contains a signature of the run in the form in which pages print it (21 CFR 11.50).

    `meaning`: for a person, `reviewed`, `approved` or `released`; for a bench, `recorded` or `evaluated`. `name`: name of the
    signer. `at`: time of signing according to the signer's clock, UTC. `key`: fingerprint of the signing key. `analyses`: numbers
    of the analyses that the signature covers. `standing`: valid (made with a key in the key ring), unknown (made with a key that
    nobody has confirmed), or invalid. `owner`: name of the key in the key ring. `why`: if the signature is not valid, the reason.
    """

    meaning: str
    name: str
    at: str
    key: str
    analyses: tuple[int, ...]
    standing: Literal["valid", "unknown", "invalid"]
    owner: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class CertificateFacts:
    """The data that only certificates show. Dates are ISO 8601.

    `laboratory`: the entry `laboratory` of the bench file. `told`: run information that was given with the run or when the
    certificate was issued. `corrected`: for each item that was changed when the certificate was issued, the value that was recorded
    with the run. `performed`: first and last day of the run. `conditions`: pairs of the name of a condition and its value as text.
    `events`: deviations from the method, each as (kind, segment, reason); the kinds are truncated, rejected and fault. `approvals`:
    approvals of the plan, each with person, time and key. `before`: estimates of the run before the adjustment, by the name of the
    estimate. `duration`: time from the first to the last sample, s. `simulated`: True if no real item was measured. `replayed`:
    True if a recording was played back.
    """

    run: str
    laboratory: Mapping[str, str] = field(default_factory=dict)
    told: Mapping[str, str] = field(default_factory=dict)
    corrected: Mapping[str, str] = field(default_factory=dict)
    references: tuple[Traced, ...] = ()
    conditions: tuple[tuple[Said, str], ...] = ()
    events: tuple[tuple[str, str, str], ...] = ()
    performed: tuple[str, str] = ("", "")
    issued: str = ""
    plan_digest: str = ""
    approvals: tuple[str, ...] = ()
    before: Mapping[str, Estimate] = field(default_factory=dict)
    before_run: str = ""
    duration: float | None = None
    simulated: bool = False
    replayed: bool = False


@dataclass(frozen=True, slots=True)
class SegmentSummary:
    """A summary of one segment as it was executed. `statistics`: None if no data were kept. `units`: maps each channel to its unit."""

    segment: Segment
    statistics: Statistics | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    remark: str = ""

    @classmethod
    def of(cls, recorded: RecordedSegment) -> SegmentSummary:
        remark = "truncated" if recorded.truncated else ""
        return cls(recorded.segment, recorded.statistics, recorded.units, remark)


@dataclass(frozen=True, slots=True)
class ReportContext:
    """All data that reports show. Mappings keep their order.

    `run_information`: information given for this run (operator, device_serial, work_order, fixture, ambient_pressure …). `bench`:
    facts about the bench (name, description …). `instruments`: maps each role to the instrument's description of itself.
    `failures`: maps each estimate that could not be made to the reason. `provenance`: versions, hashes of plan, bench, journal head
    and seal, number of the analysis, UTC times. `probability`: coverage probability of the expanded uncertainties. `certificate`:
    additional data for certificates. `on_top`: the facts at the top of the page: item, operator, date, duration, analysis.
    `origin`: whether the samples are measured, simulated or played back, if known. `seal`: SHA-256 of seal.json, if the run is
    sealed. `signatures`: signatures that the run had when the page was made.
    """

    title: str
    description: str = ""
    run_information: Mapping[str, str] = field(default_factory=dict)
    bench: Mapping[str, str] = field(default_factory=dict)
    instruments: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    site: Site | None = None
    segments: tuple[SegmentSummary, ...] = ()
    estimates: tuple[Estimate, ...] = ()
    limits: tuple[LimitVerdict, ...] = ()
    failures: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    probability: float = 0.95
    certificate: CertificateFacts | None = None
    on_top: Mapping[str, str] = field(default_factory=dict)
    origin: DataOrigin | None = None
    seal: str = ""
    signatures: tuple[PrintedSignature, ...] = ()

    @property
    def headline(self) -> Headline:
        """Returns the verdict with the number of warnings about the run and its estimates."""
        warnings = len(self.warnings) + sum(len(estimate.warnings) for estimate in self.estimates)
        return headline(self.limits, self.failures, warnings)


def site_facts(site: Site) -> dict[str, str]:
    """Returns facts about the site, by name, in customary units."""
    north_south = "N" if site.latitude >= 0 else "S"
    return {
        "Latitude": f"{abs(math.degrees(site.latitude)):.4f}° {north_south}",
        "Gravity": f"{site.gravity:.6f} m/s²",
        "Azimuth of the bench": f"{math.degrees(site.azimuth):.4f}°",
        "Earth rate": f"{math.degrees(site.earth_rate) * 3600:.6f} °/h",
    }
