"""Defines the errors for recordings that are not suitable for a diagnosis or an estimate."""

from __future__ import annotations


class ObservationError(Exception):
    """Reports that a recording cannot be diagnosed. The message states the reason; the hint states what to do, if this is known."""

    def __init__(self, message: str, hint: str = ""):
        super().__init__(message)
        self.hint = hint


class EstimationError(Exception):
    """Reports that the data or the segments are not suitable for an estimate. The message states the reason in words that a quality
    engineer understands.

    `hint`: what to do; empty if the user should choose other segments or another estimator. `key`: the key of the estimate that
    must be corrected, if any.
    """

    def __init__(self, message: str, hint: str = "", key: str = ""):
        super().__init__(message)
        self.hint = hint
        self.key = key


class UnfitDataError(EstimationError):
    """Reports that the plan is correct but the recorded data are not suitable for the estimate: the fault is in the item under test
    or in the recording."""


class EffectAbsentError(EstimationError):
    """Reports that an effect does not act on an output in the segments of an estimate. `effect`: name of the effect. `output`: name
    of the output."""

    def __init__(self, effect: str, output: str, message: str, hint: str):
        super().__init__(message, hint, f"outputs.{output}")
        self.effect = effect
        self.output = output

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.effect, self.output, str(self), self.hint)
