"""Effects that change biases randomly over time: random walks, and first-order Gauss–Markov processes."""

from __future__ import annotations

from planrunner.error_model.effects.interface import About, Actor, WithoutColumns


class GyroBiasRandomWalk(WithoutColumns):
    """Adds a random walk to the bias, beyond the declared noise, with the covariance q²·min(t, t') between the times t and t',
    where q is the rate random walk coefficient."""

    id, outside = "gyro_bias_random_walk", "random walk"
    about = About(
        "gyro bias wanders",
        "The bias of each gyro changes at random, and the changes add up over time.",
        Actor.SENSOR,
        "Repeat readings at rest more often, and let the sensor stabilise for longer before the run: {found}.",
    )


class AccelBiasRandomWalk(WithoutColumns):
    """Adds a random walk to the bias of each accelerometer, with the covariance q²·min(t, t') between the times t and t', where q
    is the coefficient of the random walk."""

    id, outside, of_accelerometers, hypothesis = "accel_bias_random_walk", "random walk", True, False
    about = About(
        "accelerometer bias wanders",
        "The bias of each accelerometer changes at random, and the changes add up over time.",
        Actor.SENSOR,
        "Repeat readings at rest more often, and let the sensor stabilise for longer before the run: {found}.",
    )


class _GaussMarkov(WithoutColumns):
    """Adds a random process b to the bias of each axis, with the standard deviation σ, the correlation time τ, and the covariance
    σ²·exp(−|t − t'|/τ) between the times t and t' (IEEE Std 952, annex C, exponentially correlated noise)."""

    outside, hypothesis, shape_name, shape_unit = "gauss-markov", False, "tau", "s"


def _about(triad: str) -> About:
    return About(
        f"{triad} bias varies with a correlation time",
        f"The bias of each {triad} varies at random about its mean, and values that are several correlation times apart "
        "are practically independent.",
        Actor.SENSOR,
        "Record for several correlation times, or repeat readings at rest within a fraction of this time: {found}.",
    )


class GyroBiasGaussMarkov(_GaussMarkov):
    """Adds a random process to the bias of each gyro, with the covariance σ²·exp(−|t − t'|/τ) between the times t and t'."""

    id, about = "gyro_bias_gauss_markov", _about("gyro")


class AccelBiasGaussMarkov(_GaussMarkov):
    """Adds a random process to the bias of each accelerometer, with the covariance σ²·exp(−|t − t'|/τ) between the times t and t'."""

    id, of_accelerometers, about = "accel_bias_gauss_markov", True, _about("accelerometer")
