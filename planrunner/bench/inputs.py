"""What bench and mounting state of uncertainty: the type B inputs of budgets, each with its source."""

from __future__ import annotations

from collections.abc import Mapping

from planrunner.bench.model import Bench
from planrunner.plan.model import MountedAxis
from planrunner.uncertainty.influences import InputQuantity, Inputs


def stated_inputs(bench: Bench, mounting: Mapping[str, MountedAxis]) -> Inputs:
    """The quantities that are stated with an uncertainty, by the names that `Inputs` lists."""
    found: list[InputQuantity] = []
    survey = bench.site.survey
    where = f"bench site, {survey.certificate}" if survey else "bench site"
    for name in ("latitude", "gravity", "azimuth"):
        stated = getattr(bench.site, name)
        if stated.standard_uncertainty:
            unit = "m/s^2" if name == "gravity" else "rad"
            found.append(
                InputQuantity(
                    name,
                    stated.value,
                    unit,
                    stated.standard_uncertainty,
                    stated.degrees_of_freedom,
                    source=where,
                    calibrated=survey.date if survey else "",
                )
            )
    for axis, mounted in mounting.items():
        if mounted.angle.standard_uncertainty:
            found.append(
                InputQuantity(
                    f"fixture angle {axis}",
                    mounted.angle.value,
                    "rad",
                    mounted.angle.standard_uncertainty,
                    mounted.angle.degrees_of_freedom,
                    source=f"plan mounting.{axis}",
                )
            )
    return Inputs({item.name: item for item in found})
