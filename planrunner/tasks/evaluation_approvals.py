"""Checks whether approvals cover the evaluation of an analysis. If the run's own plan was used for the evaluation, the approvals of
the run cover it. If an amendment used other estimates or limits, the analysis contains the approvals of the amended plan
(`approvals.json`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from planrunner.archive.analyses import StoredAnalysis
from planrunner.archive.formats import IntegrityError
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import APPROVALS, BENCH, Examined
from planrunner.base.findings import InputError
from planrunner.bench.model import Bench, bench_of
from planrunner.plan import source
from planrunner.plan.model import Plan, parse_plan
from planrunner.review.approval_files import KeptApprovals, approvals_folder, keep, kept_approvals, read_approvals
from planrunner.review.approvals import ApprovalRequest, StatedApproval, judged
from planrunner.review.meaning import equipment_of, procedure_of
from planrunner.signing.key_ring import KeyRing, parse_ring
from planrunner.tasks.amendment import EVALUATED_PLAN
from planrunner.tasks.approvals import ring_of


@dataclass(frozen=True, slots=True)
class EvaluationApproval:
    """States whether approvals cover the evaluation of one analysis.

    `analysis`: number of the analysis. `covered`: True if approvals cover its evaluation. `words`: who approved the evaluation, or
    why no approval covers it. `fault`: description of what was changed; empty if nothing was changed.
    """

    analysis: int
    covered: bool
    words: str
    fault: str = ""


def approvals_of_amended(reader: RunReader, plan: Plan, bench: Bench, file: Path) -> bytes | None:
    """Returns the approval data that the analysis with an amended plan must contain. Returns None if the bench requires no
    approvals, or if too few of the approvals next to the plan file are valid.

    Raises `InputError` if the approvals or the key ring cannot be read, and `IntegrityError` if a file of the run was changed.
    """
    rule = bench.approvals
    if rule is None or reader.approvals is None:
        return None
    of_run, _ = kept_approvals(reader.approvals, reader.path)
    keys = Path(of_run.keys)
    ring = ring_of(rule, keys.parent / "bench.yaml") if keys.name == rule.keys and keys.exists() else None
    text = of_run.ring if ring is None else ring.text
    known = parse_ring(of_run.ring, APPROVALS) if ring is None else ring.ring
    now = datetime.now(UTC)
    day, procedure, equipment = now.astimezone().date(), procedure_of(plan), equipment_of(bench)
    asked = ApprovalRequest(procedure.digest(), equipment.digest(), plan.author, now, day)
    folder = approvals_folder(file)
    found, met = judged(read_approvals(folder), rule, known, asked)
    if not met:
        return None
    counted = [one.stated for one in found if one.standing == "counts" and isinstance(one.stated, StatedApproval)]
    return keep(procedure, equipment, text, day, counted, keys, folder).to_bytes(reader.path.resolve().parent)


def evaluation_approvals(found: Examined, ring: KeyRing | None) -> Iterator[EvaluationApproval]:
    """Determines whether approvals cover the evaluation of each analysis, for a run whose bench requires approvals. `ring`: the
    user's key ring. Analyses that cannot be read are omitted, because other checks report them."""
    data, path = found.given.get(APPROVALS), found.folder.path
    if data is None or BENCH not in found.given:
        return
    try:
        bench = bench_of(found.given[BENCH], str(path / BENCH))
        kept, _ = kept_approvals(data, path)
    except (InputError, IntegrityError):
        return
    for analysis in found.analyses:
        try:
            yield _of_analysis(analysis, kept, bench, ring)
        except (InputError, IntegrityError, ValueError):
            continue


def _of_analysis(
    analysis: StoredAnalysis, of_run: KeptApprovals, bench: Bench, ring: KeyRing | None
) -> EvaluationApproval:
    number = analysis.number
    if EVALUATED_PLAN not in analysis.files:
        return EvaluationApproval(number, True, "covered by the approvals of the run")
    shown = str(analysis.path / EVALUATED_PLAN)
    plan, _ = parse_plan(source.decode(analysis.read(EVALUATED_PLAN), shown), shown)
    if plan is None:
        raise ValueError
    digest = procedure_of(plan).digest()
    if digest == of_run.plan_digest:
        return EvaluationApproval(number, True, "covered by the approvals of the run: the plans have the same meaning")
    if APPROVALS not in analysis.files or bench.approvals is None:
        return EvaluationApproval(
            number, False, "NOT covered by an approval: the plan of the amendment was not approved"
        )
    kept, damaged = kept_approvals(analysis.read(APPROVALS), analysis.path)
    known = parse_ring(kept.ring, str(analysis.path / APPROVALS)) if ring is None else ring
    made = datetime.fromisoformat(str(analysis.digests["made"]))
    asked = ApprovalRequest(digest, of_run.bench_digest, plan.author, made, made.astimezone().date())
    judgements, met = judged([*kept.approvals, *damaged], bench.approvals, known, asked)
    bad = [f"{one.stated.file}: {one.why}" for one in judgements if one.standing != "counts"]
    if bad or not met:
        fault = f"{analysis.path / APPROVALS}: the approvals of the amended plan are not all valid: {'; '.join(bad)}"
        return EvaluationApproval(number, False, "NOT covered by a valid approval", fault)
    names = ", ".join(one.name for one in kept.approvals)
    return EvaluationApproval(number, True, f"covered by approvals of its own plan by {names}")
