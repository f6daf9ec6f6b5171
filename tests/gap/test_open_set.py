"""Something else, of several sorts at once: what one sort does to the nominal parameters is not counted again in the others."""

from __future__ import annotations

import numpy as np
import pytest

from planrunner.gap.candidates import Weighing
from planrunner.gap.observed import Observed
from planrunner.gap.open_set import Kinds, competitors
from tests.gap.turntable import record

Array = np.ndarray


@pytest.fixture(scope="module")
def rocked() -> tuple[Weighing, Kinds]:
    """The scale factor of z is another one while the table rocks: the fitted one is neither, and every turn about z stands off."""

    def fault(observed: Observed, omega: Array, force: Array, draw: np.random.Generator) -> tuple[Array, float]:
        rocking = (observed.acceleration != 0)[:, None]
        return np.where(rocking, omega * np.array([0.0, 0.0, 0.03]), 0.0), 0.0

    weighing = Weighing(record(seed=41, fault=fault))
    return weighing, competitors(weighing)


def test_no_evidence_is_more_than_half_the_energy(rocked: tuple[Weighing, Kinds]) -> None:
    """Of a Gaussian with known variance nothing gains more than it does by fitting every coefficient."""
    weighing, kinds = rocked
    most = sum(float(each[0].residual @ each[0].residual) for each in weighing.weights) / 2
    apart = sum(float(value[0]) for name, value in kinds.log_bayes.items() if name in SORTS)
    assert apart > most
    assert kinds.several[0] < most


def test_the_strongest_sort_is_counted_whole(rocked: tuple[Weighing, Kinds]) -> None:
    _, kinds = rocked
    assert kinds.several[0] > kinds.log_bayes["rocking waveform"][0] - 10


SORTS = ("rocking waveform", "offset per segment", "transient per segment")
