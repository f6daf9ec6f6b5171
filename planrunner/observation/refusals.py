"""Why a recording cannot give what is asked of it: in a diagnosis, or in an estimate."""

from __future__ import annotations


class ObservationError(Exception):
    """The recording cannot be diagnosed. The message gives the reason; the hint gives the remedy, if known."""

    def __init__(self, message: str, hint: str = ""):
        super().__init__(message)
        self.hint = hint


class EstimationError(Exception):
    """The data or the segments cannot give this estimate. The message says why, for a quality engineer.

    hint: what to do, where other segments or another estimator would not help. key: of the estimate, where one is to be mended.
    """

    def __init__(self, message: str, hint: str = "", key: str = ""):
        super().__init__(message)
        self.hint = hint
        self.key = key


class UnfitDataError(EstimationError):
    """The plan asks for what can be estimated, and what was recorded does not give it: the item or the recording is in question."""
