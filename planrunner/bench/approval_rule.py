"""The approvals that a bench requires: who must have approved a plan before it may run."""

from __future__ import annotations

from planrunner.base.findings import Findings
from planrunner.plan.kinds import Boolean, ListOf, Number, Record, RecordOf, Text, key
from planrunner.plan.model import PERSON

ROLE = r"[a-z][a-z0-9_-]{0,39}"
_PART = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,79}"
MOST = 20
"""Largest number of approvals that a bench can require."""


class ApprovalRule(Record):
    """Approvals that a plan needs before it may run on this bench. Rules that are not stated restrict nothing."""

    keys: str = key(
        Text(rf"{_PART}(/{_PART}){{0,4}}", "a file in the folder of the bench file or in a folder of it"),
        "Key ring of the laboratory, relative to the bench file.",
        "lab-keys.yaml",
    )
    required: int = key(
        Number(1, MOST, integer=True), "Number of persons who must have approved the plan.", 2, default=1
    )
    by: tuple[str, ...] = key(
        ListOf(Text(PERSON, "a name in the key ring"), minimum=1),
        "Persons whose approvals count, by their names in the key ring; by default all.",
        ["anna", "ben"],
        default_factory=tuple,
    )
    roles: tuple[str, ...] = key(
        ListOf(Text(ROLE, "a role"), minimum=1),
        "An approval counts only if its key has one of these roles in the key ring; by default any key counts.",
        ["reviewer"],
        default_factory=tuple,
    )
    author_may_approve: bool = key(
        Boolean(), "Whether approvals by an `author` of the plan count.", False, default=False
    )
    withdrawn: tuple[str, ...] = key(
        ListOf(Text(r"[0-9a-f]{64}", "a SHA-256 digest")),
        "Approvals that do not count on this bench, by the digests that `planrunner approve --list` prints. "
        "Somebody can delete a withdrawal that is beside the plan; an entry of this list stays.",
        ["9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"],
        default_factory=tuple,
    )


def _check(rule: ApprovalRule, log: Findings) -> None:
    if rule.by and len(set(rule.by)) < rule.required:
        message = f"{rule.required} approvals are required, but only {len(set(rule.by))} persons are named in `by`"
        log.error("meaning-approvals", rule.at("required"), message, "require fewer approvals, or name more persons")


APPROVALS = RecordOf(ApprovalRule, _check)
