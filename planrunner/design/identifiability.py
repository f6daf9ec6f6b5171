"""Determines which coefficients the planned segments can determine. Computes the rank, the condition, and the terms that cannot be
separated."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.estimators import rank
from planrunner.estimators.interface import Design, DesignBlock


@dataclass(frozen=True, slots=True)
class Identifiability:
    """The information that the planned segments give about one output.

    `rank`: rank of the design matrix, whose columns are the terms. `condition`: condition number of the columns divided by their
    declared magnitudes; infinite if the rank is deficient. `determinant`: determinant of the information matrix of the divided
    columns, if all segments have the same weight. Sets of positions are compared by this number. `unidentifiable`: names of the
    terms that cannot be identified. `explanation`: a sentence about these terms; empty if all terms can be identified.
    """

    output: str
    rank: int
    columns: int
    condition: float
    determinant: float
    unidentifiable: tuple[str, ...]
    explanation: str

    @property
    def sound(self) -> bool:
        return self.rank == self.columns


def identify(design: Design) -> tuple[Identifiability, ...]:
    """Returns the `Identifiability` of each output of a design. Outputs that share a design matrix are analysed once."""
    found: list[Identifiability] = []
    for place, block in enumerate(design.blocks):
        alike = [k for k, other in enumerate(design.blocks[:place]) if _alike(other, block)]
        found.append(replace(found[alike[0]], output=block.output) if alike else identify_block(block))
    return tuple(found)


def _alike(one: DesignBlock, other: DesignBlock) -> bool:
    return one.matrix is other.matrix and one.magnitudes is other.magnitudes and one.terms == other.terms


def identify_block(block: DesignBlock) -> Identifiability:
    """Returns the `Identifiability` of one output, from its design matrix. A matrix without rows has rank 0 and contains no
    information."""
    columns = len(block.terms)
    scaled = np.asarray(block.matrix, dtype=float).reshape(-1, columns) / block.magnitudes
    if len(scaled) == 0:
        return Identifiability(block.output, 0, columns, math.inf, 0.0, tuple(block.terms), "no segments are chosen")
    sight = rank.look(scaled)
    explanation = rank.explain(sight.null, block.terms)
    if sight.rank < columns and len(scaled) < columns:
        explanation = f"{len(scaled)} segments cannot determine {columns} coefficients; {explanation}"
    names = rank.unidentifiable(sight.null, block.terms)
    return Identifiability(block.output, sight.rank, columns, sight.condition, sight.determinant, names, explanation)
