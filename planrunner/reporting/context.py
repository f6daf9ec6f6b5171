"""Input of reports: plain records, independent of instruments and estimators."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from planrunner.archive.recording import RecordedSegment, Statistics
from planrunner.base.said import Said
from planrunner.estimators.interface import Estimate
from planrunner.estimators.limits import LimitVerdict
from planrunner.estimators.results import DataOrigin
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Segment
from planrunner.reporting.verdict import Headline, headline


@dataclass(frozen=True, slots=True)
class Traced:
    """A reference used in the calibration: the site or an instrument, its description of itself, and its stated calibration."""

    name: Said
    identity: str = ""
    certificate: str = ""
    date: str = ""
    due: str = ""
    laboratory: str = ""


@dataclass(frozen=True, slots=True)
class PrintedSignature:
    """A signature of the run as pages print it (21 CFR 11.50). meaning: `reviewed`, `approved`, `released`, or for a bench
    `recorded`, `evaluated`; name: name of the signer; at: time according to the signer's clock, UTC; key: fingerprint of the key;
    analyses: numbers of the analyses that the signature covers. standing: valid (made with a key of the key ring), unknown (made
    with a key that nobody has confirmed), or invalid; owner: name of the key in the key ring; why: the reason why the signature is
    not valid."""

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
    """Data that only certificates show. Dates are ISO 8601.

    laboratory: the bench file's `laboratory`. told: run information, from the run and from the issue of the certificate; corrected:
    name of each item that was changed at the issue → value recorded with the run. performed: first and last day of the run.
    conditions: (name, text). events: deviations from the method, as (kind, segment, reason) with the kinds truncated, rejected,
    fault. approvals: approvals of the plan, each with person, time and key. before: estimates of the run before the adjustment, by
    name. duration: time from the first to the last sample, s. simulated: True if no real item was measured; replayed: True if a
    recording was played back.
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
    """One segment as executed. statistics: None if no data were kept. units: channel → unit."""

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

    run_information: information given for this run (operator, device_serial, work_order, fixture, ambient_pressure …). bench: facts
    about the bench (name, description …); instruments: role → identity as the instrument gave it. failures: estimates that could
    not be made → reason. provenance: versions, hashes of plan, bench, journal head and seal, number of the analysis, UTC times.
    probability: coverage probability of the expanded uncertainties. certificate: additional data for certificates. on_top: the most
    important facts: item, operator, date, duration, analysis. origin: source of the samples, if known. seal: SHA-256 of seal.json,
    if the run is sealed. signatures: signatures of the run that were made before the page.
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
        """The verdict, together with the number of warnings of the run and of its estimates."""
        warnings = len(self.warnings) + sum(len(estimate.warnings) for estimate in self.estimates)
        return headline(self.limits, self.failures, warnings)


def site_facts(site: Site) -> dict[str, str]:
    """The site in words and customary units."""
    north_south = "N" if site.latitude >= 0 else "S"
    return {
        "Latitude": f"{abs(math.degrees(site.latitude)):.4f}° {north_south}",
        "Gravity": f"{site.gravity:.6f} m/s²",
        "Azimuth of the bench": f"{math.degrees(site.azimuth):.4f}°",
        "Earth rate": f"{math.degrees(site.earth_rate) * 3600:.6f} °/h",
    }
