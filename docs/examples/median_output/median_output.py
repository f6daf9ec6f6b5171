"""A robust level: the median of one output over the chosen segments, with the standard uncertainty of a median."""

import numpy as np

from planrunner.estimators.interface import Coefficient, Estimate, EstimationError
from planrunner.plan.kinds import Record, Text, key


class MedianParameters(Record):
    output: str = key(Text(), "Output whose level is computed.", "torquer_x")


class MedianOutput:
    summary = "Median level of one output"
    Parameters = MedianParameters

    def design(self, request):
        return None  # no linear model: nothing to predict before the run

    def estimate(self, request):
        output = request.parameters.output
        if output not in request.segments[0].units:
            raise EstimationError(f"the recording has no channel '{output}'")
        blocks = [b.channels[output] for part in request.segments for b in part.blocks([output])]
        values = np.concatenate(blocks)
        values = values[np.isfinite(values)]
        middle = float(np.median(values))
        sigma = 1.4826 * float(np.median(np.abs(values - middle)))
        uncertainty = float(np.sqrt(np.pi / 2) * sigma / np.sqrt(values.size))
        unit = request.segments[0].units[output]
        level = Coefficient("level", middle, unit, uncertainty, values.size - 1, f"median of {output}")
        return Estimate(
            name=request.name,
            estimator="median_output",
            coefficients=(level,),
            covariance=np.array([[uncertainty**2]]),
            headline=("level",),
            segments=tuple(part.label for part in request.segments),
        )
