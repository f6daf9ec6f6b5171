"""Errors for recordings that are not suitable for a diagnosis or an estimate."""

from __future__ import annotations


class ObservationError(Exception):
    """The recording cannot be diagnosed. The message gives the reason; the hint gives the remedy, if known."""

    def __init__(self, message: str, hint: str = ""):
        super().__init__(message)
        self.hint = hint


class EstimationError(Exception):
    """The data or the segments are not suitable for this estimate. The message gives the reason, for a quality engineer.

    hint: the remedy, if it is other than to choose other segments or another estimator. key: the key of the estimate that must be
    corrected, if there is one.
    """

    def __init__(self, message: str, hint: str = "", key: str = ""):
        super().__init__(message)
        self.hint = hint
        self.key = key


class UnfitDataError(EstimationError):
    """The plan is correct, but the recorded data are not suitable for the estimate: the fault is in the item under test or in the
    recording."""
