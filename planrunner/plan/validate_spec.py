"""The key `validate` of an estimate: its stated intervals are held against Monte Carlo draws (JCGM 101)."""

from __future__ import annotations

from planrunner.plan.kinds import Number, Record, key


class MonteCarloSpec(Record):
    """How the draws are made."""

    digits: int = key(
        Number(1, 2, integer=True),
        "Digits of the standard uncertainty that are regarded as meaningful: half a unit of the last one is the tolerance.",
        1,
        default=1,
    )
    draws: int = key(
        Number(20_000, 10_000_000, integer=True),
        "Largest number of draws, if the results do not stabilise earlier.",
        1_000_000,
        default=1_000_000,
    )
    seed: int = key(Number(0, 2**31, integer=True), "Seed of the draws.", 1, default=1)


USUAL = MonteCarloSpec(digits=1, draws=1_000_000, seed=1)
