"""Simulates a gimballed platform: three accelerometers on a stabilised element within gimbals, mounted rigidly on the virtual
table.

When caged, the element is fixed to the base, with an attitude error that is random for each caging. In navigation, the element is
released and stays fixed in inertial space, except for its drift. The attitude of the element is simulated, and the outputs of
accelerometers and gimbal encoders are computed from it. The estimators have no formula in common with this module.

A ring of a rocking table has a random return error each time it comes to rest. The reading of the ring lags while the ring moves,
and the servo of the ring drifts over minutes. The error of a multi-speed gimbal resolver has a period of a fraction of a turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.instruments.interfaces import Block, InstrumentError, Surroundings
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.instruments.virtual.base_motion import base_axes, shaking, turn_by
from planrunner.instruments.virtual.courses import Course, Rocking
from planrunner.instruments.virtual.noise import Readout, generator
from planrunner.instruments.virtual.platform_parameters import VirtualPlatformParameters
from planrunner.instruments.virtual.stabilised_element import DriftLaw, Element
from planrunner.instruments.virtual.streaming import Sampling
from planrunner.instruments.virtual.world import World
from planrunner.plan.schedule import Segment
from planrunner.plan.units import STANDARD_GRAVITY


@dataclass(slots=True)
class RingEncoders:
    """The readings of the table's ring encoders during one recording.

    `before`, `after`: arrays of shape (k,) in rad, deviation of each ring's position from its reading, before and after the ring
    has come to rest at the end of the rocking. `lag`: time [s] by which a reading lags behind a moving ring. `wander`: coefficient
    of the random walk of the servos, rad/√s.
    """

    before: Array
    after: Array
    lag: float
    wander: float
    wandered: Array

    @classmethod
    def drawn(
        cls, rings: int, return_error: float, lag: float, wander: float, draw: np.random.Generator
    ) -> RingEncoders:
        before, after = return_error * draw.standard_normal((2, rings))
        return cls(before, after, lag, wander, np.zeros(rings))

    def read(self, course: Course, times: Array, step: float, draw: np.random.Generator) -> list[Array]:
        """Returns the angles [rad] that the encoders show at `times` (n,), s, as one array (n,) for each ring, the outermost first.
        The times are `step` seconds apart."""
        over = course.over if isinstance(course, Rocking) else math.inf
        readings = []
        for k, (angle, rate) in enumerate(course.follow(times)):
            wandering = self.wandered[k] + np.cumsum(self.wander * math.sqrt(step) * draw.standard_normal(times.size))
            self.wandered[k] = wandering[-1]
            off = np.where(times >= over, self.after[k], self.before[k]) + wandering
            readings.append(angle - off - self.lag * rate)
        return readings


def gimbal_angles(base: Array, element: Array) -> tuple[Array, Array, Array]:
    """Returns the outer, the middle and the inner gimbal angle [rad] as three arrays of shape (n,). `base`, `element`: axes of the
    base and of the element as rows; both arrays have the shape (n, 3, 3).

    The outer gimbal turns about the x axis of the base. The middle gimbal turns about its own y axis. The inner gimbal carries the
    element and turns about its own z axis.
    """
    between = np.einsum("nij,nkj->nik", element, base)
    outer = np.arctan2(-between[:, 2, 1], between[:, 2, 2])
    middle = np.arcsin(np.clip(between[:, 2, 0], -1.0, 1.0))
    inner = np.arctan2(-between[:, 1, 0], between[:, 0, 0])
    return outer, middle, inner


def resolver(angle: Array, error: float, speeds: int, phase: float) -> Array:
    """Returns the reading [rad] of a resolver at `angle` [rad]. `speeds`: number of electrical turns per mechanical turn. `error`:
    amplitude of the resolver's error [rad]. `phase`: phase of this error at the angle zero, rad."""
    return angle + error * np.sin(speeds * angle + phase)


ACCELEROMETERS = ("accel_x", "accel_y", "accel_z")
GIMBALS = ("gimbal_outer", "gimbal_middle", "gimbal_inner")
RINGS = ("table_outer", "table_middle", "table_inner")
RANGES = {"1.25 g": 1.25, "20 g": 20.0}
BLOCK = 10_000  # samples; about a dozen matrices per sample are kept in memory


class VirtualPlatform:
    """A simulated platform on the virtual table."""

    role = "sensor"
    Parameters = VirtualPlatformParameters

    def __init__(self, parameters: VirtualPlatformParameters, world: World):
        self.parameters = parameters
        self.world = world
        self.cagings = 0
        self.element = Element(np.zeros(3))
        self.drift = np.zeros(3)  # rad/s, of this release beside the constant one
        self.bias_walk = np.zeros(3)  # m/s^2
        self.walked_until = 0.0
        draw = self._draw(0, 2)
        p = parameters.accelerometers
        self.bias = p.bias.value * draw.standard_normal(3)
        self.phases = draw.uniform(0.0, 2 * math.pi, 3)
        self._cage()

    @classmethod
    def model(cls, parameters: VirtualPlatformParameters) -> SensorModel:
        p = parameters.accelerometers
        full_scale = RANGES[p.range]
        noise = NoiseModel(p.white_noise.value / STANDARD_GRAVITY, 0.0, _count(parameters) / STANDARD_GRAVITY)
        accelerometers = tuple(OutputModel(name, "g", full_scale, noise) for name in ACCELEROMETERS)
        fine, rings = parameters.gimbal_encoders.resolution.value, parameters.table_encoders.resolution.value
        gimbals = tuple(OutputModel(name, "deg", 360.0, NoiseModel(0.0, 0.0, math.degrees(fine))) for name in GIMBALS)
        table = tuple(
            OutputModel(name, "deg", noise=NoiseModel(0.0, 0.0, math.degrees(rings)), constant=True)
            for name in RINGS[: parameters.rings]
        )
        outputs = (*accelerometers, *gimbals, *table)
        modes = ("caged", "navigation")
        return SensorModel("stabilised-platform", outputs, parameters.sample_rate.value, modes=modes, stabilised=True)

    @classmethod
    def connect(cls, parameters: VirtualPlatformParameters, surroundings: Surroundings) -> VirtualPlatform:
        return cls(parameters, World.of(surroundings))

    # -- what it does --------------------------------------------------------------------------------------------------

    def set_mode(self, mode: str) -> float:
        if mode == "caged":
            self.cagings += 1
            self._cage()
            return self.parameters.caging.duration.value
        if mode != "navigation":
            raise InstrumentError(f"the platform has no mode '{mode}': it is caged or in navigation")
        left = self.parameters.caging.leaving.value * self._draw(self.cagings, 1).standard_normal(3)
        self.element = self.element.release(self.world, left)
        return 0.0

    def channels(self) -> Mapping[str, str]:
        rings = len(self.world.axes)
        if rings != self.parameters.rings:
            raise InstrumentError(
                f"the bench file declares {self.parameters.rings} rings for the platform, but the table has {rings}"
            )
        return {**dict.fromkeys(ACCELEROMETERS, "g"), **dict.fromkeys((*GIMBALS, *RINGS[:rings]), "deg")}

    def stream(self, segment: Segment) -> Iterator[Block]:
        sampling = Sampling.of(self.world, segment, self.model(self.parameters))
        sampling = replace(sampling, size=min(sampling.size, BLOCK))
        draw = generator(self.world.seed, segment.index)
        law = self._law()
        self.element = self.element.advance(self.world, sampling.start, law, draw)
        idle = max(0.0, sampling.start - self.walked_until)
        p = self.parameters
        self.bias_walk = self.bias_walk + p.accelerometers.bias_walk.value * math.sqrt(idle) * draw.standard_normal(3)
        e = p.table_encoders
        rings = RingEncoders.drawn(p.rings, e.return_error.value, e.lag.value, e.wander.value, draw)

        def make(first: int, length: int) -> Block:
            times = sampling.times(first, length)
            base = base_axes(self.world, times)
            axes, self.element = self.element.follow(self.world, times, 1 / sampling.rate, base, law, draw)
            readings = dict(zip(ACCELEROMETERS, self._accelerations(times, axes, sampling.rate, draw), strict=True))
            readings |= self._encoders(times, 1 / sampling.rate, base, axes, rings, draw)
            return Block(times, readings)

        yield from sampling.blocks(self.world, make)

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "planrunner", "model": "virtual stabilised platform"}

    def make_safe(self) -> None:
        """Does nothing: the element may remain released, because its gimbals carry no load that could fall."""

    def close(self) -> None:
        """Does nothing, because there are no open resources."""

    def checkpoint(self) -> Mapping[str, Json]:
        return {
            "cagings": self.cagings,
            "element": self.element.to_json(),
            "drift": self.drift.tolist(),
            "bias_walk": self.bias_walk.tolist(),
            "walked_until": self.walked_until,
        }

    def restore(self, state: Mapping[str, Json]) -> None:
        self.cagings = int(state["cagings"])
        self.element = Element.from_json(state["element"])
        self.drift = np.array(state["drift"], dtype=float)
        self.bias_walk = np.array(state["bias_walk"], dtype=float)
        self.walked_until = float(state["walked_until"])

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _draw(self, caging: int, what: int = 0) -> np.random.Generator:
        """Returns the random generator for one caging. The caging number 0 is used for properties that never change, such as the
        biases. This generator is independent of the generators of the segments. `what`: number of the purpose for which random
        numbers are drawn."""
        return np.random.Generator(
            np.random.SFC64(np.random.SeedSequence(self.world.seed, spawn_key=(caging, what, 0)))
        )

    def _cage(self) -> None:
        """Cages the element. The caged element is level to within the dead zone of the levelling loops. The azimuth of the
        element differs from caging to caging by the stated repeatability."""
        p, draw = self.parameters, self._draw(self.cagings)
        base = base_axes(self.world, np.array([self.world.now()]))[0]
        up = base[:, 2]
        level = p.caging.dead_region.value * draw.uniform(-1.0, 1.0, 3)
        level -= up * (up @ level)
        self.element = Element(level + up * p.caging.azimuth.value * draw.standard_normal())
        self.drift = p.drift_repeatability.value * draw.standard_normal(3)

    def _law(self) -> DriftLaw:
        p = self.parameters
        constant = np.array([p.drift.x.value, p.drift.y.value, p.drift.z.value]) + self.drift
        rocking = p.rocking_drift
        rectified = np.zeros(3)
        if rocking is not None:
            rectified = np.array([rocking.x.value, rocking.y.value, rocking.z.value]) / rocking.rms_rate.value**2
        return DriftLaw(constant, rectified, p.random_walk.value, p.caging.leaving_time.value)

    def _accelerations(self, times: Array, axes: Array, rate: float, draw: np.random.Generator) -> list[Array]:
        """Returns the readings (n,) of each accelerometer [g]. `times`: array of shape (n,), s. `axes`: array of shape (n, 3, 3),
        axes of the element as rows in East-North-Up."""
        p = self.parameters.accelerometers
        arm = [item.value for item in self.parameters.lever_arm]
        force = self.world.site.specific_force_enu + shaking(self.world, times, arm)
        felt = np.einsum("nij,nj->ni", axes, force) @ self._input_axes().T
        steps = p.bias_walk.value / math.sqrt(rate) * draw.standard_normal(felt.shape)
        walk = self.bias_walk + np.cumsum(steps, axis=0)
        self.bias_walk, self.walked_until = walk[-1], float(times[-1]) + 1 / rate
        g = STANDARD_GRAVITY
        readout = Readout(p.white_noise.value * math.sqrt(rate) / g, _count(self.parameters) / g, RANGES[p.range])
        levels = (felt + self.bias + walk) / g
        return [readout.samples(draw, levels[:, k], times.size, 1) for k in range(3)]

    def _input_axes(self) -> Array:
        """Returns the accelerometers' input axes (3, 3) as rows in axes of the element; each is rotated about the other two axes in
        succession."""
        q = self.parameters.accelerometers.installation
        x, y, z = np.eye(3)
        turns = (
            (x, q.xz.value * z, q.xy.value * y),
            (y, q.yz.value * z, q.yx.value * x),
            (z, q.zy.value * y, q.zx.value * x),
        )
        return np.vstack([turn_by(turn_by(own[None], first), second) for own, first, second in turns])

    def _encoders(
        self, times: Array, step: float, base: Array, axes: Array, rings: RingEncoders, draw: np.random.Generator
    ) -> dict[str, Array]:
        """Returns the readings (n,) of each gimbal and ring [deg]. `times`: array of shape (n,), s. `base`, `axes`: arrays of shape
        (n, 3, 3), axes of the base and of the element as rows in East-North-Up."""
        p = self.parameters
        readings = {}
        for name, angle, phase in zip(GIMBALS, gimbal_angles(base, axes), self.phases, strict=True):
            shown = resolver(angle, p.gimbal_encoders.error.value, p.gimbal_encoders.speeds, phase)
            readings[name] = _counted(shown, p.gimbal_encoders.resolution.value)
        for name, angle in zip(RINGS, rings.read(self.world.course, times, step, draw), strict=False):
            readings[name] = _counted(angle, p.table_encoders.resolution.value)
        return readings


def _count(parameters: VirtualPlatformParameters) -> float:
    """Returns the size of one count of an accelerometer [m/s^2]."""
    p = parameters.accelerometers
    return 2 * RANGES[p.range] * STANDARD_GRAVITY / float(2**p.bits)


def _counted(angle: Array, resolution: float) -> Array:
    """Rounds angles [rad] to whole counts of the size `resolution` [rad], and returns them in degrees."""
    return np.degrees(np.rint(angle / resolution) * resolution if resolution > 0 else angle)
