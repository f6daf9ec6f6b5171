"""The plot of every linear fit: residuals with the uncertainty that the noise within the segments gives them."""

from __future__ import annotations

from planrunner.estimators.interface import Plot
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.observation.observations import Observations


def residual_plot(
    observations: Observations,
    fit: OutputsFit,
    title: str = "Residuals per position",
    x_title: str = "position",
    x: tuple[float | str, ...] = (),
) -> Plot:
    """One series per output, in the unit of the first output, over the labels of the segments unless `x` is given."""
    n = len(observations.labels)
    series = {
        name: tuple(map(float, one.residuals[:n])) for name, one in zip(observations.channels, fit.fits, strict=True)
    }
    spreads = {
        name: tuple(map(float, noise.sigma[:n]))
        for name, noise in zip(observations.channels, fit.noises, strict=True)
        if noise.known
    }
    return Plot(title, x_title, f"residual [{observations.units[0]}]", x or observations.labels, series, spreads)
