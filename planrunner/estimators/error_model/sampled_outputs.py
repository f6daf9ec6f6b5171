"""Reads the samples of a recording, or makes the planned samples of a schedule, for outputs that are fitted to samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment, in_time_order
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import InputError
from planrunner.error_model.added import addition
from planrunner.error_model.observed import Channel
from planrunner.error_model.scheduled import everything, sensor_channels
from planrunner.error_model.segment_columns import KINDS, OutputErrors
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.error_model.within import SampledOutput
from planrunner.estimators.interface import EstimationError
from planrunner.instruments.models import NoiseModel, SensorModel
from planrunner.observation.refusals import ObservationError
from planrunner.observation.samples import observed
from planrunner.physics.earth import Site
from planrunner.plan.units import unit

_LEAST = 1e-9  # of the largest value of an output: smallest noise of a sample that the weights assume


@dataclass(frozen=True, slots=True, eq=False)
class SampledOutputs:
    """Gives access to the samples of an estimate's segments. `recording`: all segments of the estimate, recorded or expected from
    the schedule."""

    recording: Sequence[RecordedSegment]
    site: Site
    sensor: SensorModel
    parameters: ErrorModelParameters

    def in_time(self, rows: Sequence[int]) -> tuple[int, ...]:
        """Returns the segments in the order in which they were recorded."""
        place = {id(self.recording[row]): row for row in rows}
        return tuple(place[id(one)] for one in in_time_order([self.recording[row] for row in rows]))

    def of(self, group: Sequence[OutputErrors], rows: Sequence[int]) -> list[SampledOutput]:
        """Returns the samples of the given outputs. Raises `EstimationError` if a segment has no suitable samples."""
        held, parameters = [self.recording[row] for row in rows], self.parameters
        channels = [self._channel(errors, held[0].units[errors.output]) for errors in group]
        try:
            seen = observed(
                held,
                self.site,
                self.sensor,
                measured=channels,
                angle_channel=parameters.angle_channel,
                temperature_channel=parameters.temperature_channel,
                supply_channel=parameters.supply_channel,
                pressure_channel=parameters.pressure_channel,
                magnetic=self.site.magnetic_field,
            )
        except ObservationError as refused:
            raise EstimationError(str(refused), refused.hint) from None
        expected = self._expected()
        found = []
        for k, (errors, channel) in enumerate(zip(group, channels, strict=True)):
            values = seen.values[:, k] / channel.factor
            least = (_LEAST * float(np.abs(values).max(initial=0.0))) ** 2 or _LEAST**2
            statistics = [one.statistics for one in held]
            planned = all(one.expected for one in held)
            own = np.array([one.covariance[one.of(errors.output), one.of(errors.output)] for one in statistics])
            if not planned:  # the fit begins with equal noise
                own = np.full(len(own), np.median(own[own > 0]) if (own > 0).any() else 0.0)
            variance = np.maximum(own, least) / seen.bin_size
            means = np.array([one.standard_error[one.of(errors.output)] for one in statistics])
            rough = np.sqrt(variance / np.diff(seen.bounds))
            means = np.where(means > rough, means, rough)
            scale = "gyro_scale_factor" if errors.kind == "gyro" else "accel_scale_factor"
            direct = unit(channel.unit).dimension == unit(KINDS[errors.kind]).dimension
            gain = self.sensor.nominal.get(f"K_{errors.output}", 1.0) / channel.factor
            found.append(
                SampledOutput(
                    seen,
                    errors,
                    unit(channel.unit),
                    None if planned else values,
                    variance,
                    means,
                    any(part.effect.id == scale for part in errors.chosen),
                    1 / channel.factor if direct else gain,
                    channel.flicker / channel.factor,
                    expected,
                )
            )
        return found

    def _channel(self, errors: OutputErrors, text: str) -> Channel:
        output = self.sensor.output(errors.output)
        noise, factor = output.noise if output else NoiseModel(), unit(text).factor
        numbers = (noise.white * factor, noise.bias_instability * factor, noise.resolution * factor)
        return Channel(errors.output, errors.kind, errors.axis, text, factor, *numbers)

    def _expected(self) -> Mapping[str, Mapping[str, float]]:
        """Returns the expected values that the plan states for parameters of effects, in their units."""
        parameters = self.parameters
        if not parameters.expected:
            return {}
        whole = everything(self.site, sensor_channels(self.sensor), self.sensor.sample_rate)
        made = {}
        for name, stated in parameters.expected.items():
            try:
                made[name] = addition(name, stated, whole, parameters.at(f"expected.{name}")).values
            except InputError as error:
                finding = next(iter(error.findings))
                raise EstimationError(finding.message, finding.hint, f"expected.{name}") from None
        return made
