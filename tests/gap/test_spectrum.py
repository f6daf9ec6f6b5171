"""The basis of a segment, its energy, and spikes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planrunner.gap.evidence.spectrum import spectrum, white_level
from planrunner.gap.hypotheses.candidates import FULL, simulated
from tests.gap.turntable import GYRO_WHITE, RATE, record


def test_bases_are_orthonormal_and_energy_is_kept() -> None:
    observed = record()
    reference = simulated(observed, FULL)
    found = spectrum(observed, reference)
    for basis in found.bases:
        assert basis.vectors.T @ basis.vectors == pytest.approx(np.eye(len(basis.frequency)), abs=1e-9)
    whole = ((observed.values - reference) ** 2).sum(0)
    assert (found.values**2).sum(0) + found.energy.sum((0, 1)) == pytest.approx(whole, rel=1e-9)
    assert found.count.sum() + len(found.segment) == len(observed.time)
    assert not found.spikes.any()


def test_the_white_level_is_found_and_spikes_do_not_move_it() -> None:
    observed = record()
    values = observed.values.copy()
    values[::731, 0] += 3.0
    spiked = replace(observed, values=values)
    reference = simulated(observed, FULL)
    clean, dirty = spectrum(observed, reference), spectrum(spiked, reference)
    level = GYRO_WHITE * np.sqrt(RATE)
    assert white_level(observed, clean)[0][:3] == pytest.approx([level] * 3, rel=0.05)
    assert white_level(spiked, dirty)[0][0] == pytest.approx(level, rel=0.05)
    assert dirty.spikes[0] == len(values[::731])
    assert dirty.values[:, 0] == pytest.approx(clean.values[:, 0], abs=8 * level)
