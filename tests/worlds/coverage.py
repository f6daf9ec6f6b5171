"""How often the 95 % intervals that planrunner gives hold the truth of a world, and how often it warns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.estimators.analysis import analyse
from planrunner.estimators.interface import Estimate
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Segment
from planrunner.tasks.check import Document, Sound, check_plan
from planrunner.uncertainty.decision import expanded_uncertainty
from tests.worlds.campaigns import CAMPAIGNS, Campaign
from tests.worlds.faults import ARCSEC, WORLDS, Recorded, World
from tests.worlds.felt import felt

Array = NDArray[np.float64]
BLOCK = 9973  # rows
THERMOMETER = "sensor_temperature"


@dataclass
class Tally:
    """What came of many recordings. held: coefficient → how often its interval held the truth; squares: coefficient → sum of squared errors
    in standard uncertainties; shares, shares_squared: sums over the runs of the share of intervals that held the truth; warned: runs with a
    warning; named: runs in which a warning names the world's cause; failed: messages of runs without an estimate."""

    runs: int = 0
    warned: int = 0
    named: int = 0
    held: dict[str, int] = field(default_factory=dict)
    squares: dict[str, float] = field(default_factory=dict)
    shares: float = 0.0
    shares_squared: float = 0.0
    failed: list[str] = field(default_factory=list)

    @property
    def estimates(self) -> int:
        return self.runs - len(self.failed)

    @property
    def coverage(self) -> tuple[float, float]:
        """Share of all intervals that held the truth, and its standard error. Intervals of one run are not independent of each other, so
        the runs' scatter gives it, and at least one interval that missed the truth."""
        n = max(self.estimates, 1)
        mean = self.shares / n
        return mean, math.sqrt(max(self.shares_squared / n - mean**2, 1 / (n * len(self.held or [0]))) / n)

    def add(self, other: Tally) -> None:
        """Further runs of the same campaign in the same world."""
        self.runs, self.warned, self.named = (
            self.runs + other.runs,
            self.warned + other.warned,
            self.named + other.named,
        )
        self.shares, self.shares_squared = self.shares + other.shares, self.shares_squared + other.shares_squared
        for name in other.held:
            self.held[name] = self.held.get(name, 0) + other.held[name]
            self.squares[name] = self.squares.get(name, 0.0) + other.squares[name]
        self.failed += other.failed


def known(campaign: Campaign, world: World) -> Sound:
    """The plan on a bench that states what the world's tilts, rates, flicker and counts are. Raises `InputError`."""
    flicker, count = (
        size / campaign.declared for size in (world.flicker * campaign.mean, world.count * campaign.white)
    )
    bench = campaign.bench.format(tilt=world.tilt / ARCSEC, rate=world.rate * 1e6, flicker=flicker, count=count)
    if world.silent:
        bench = "".join(line for line in bench.splitlines(keepends=True) if "bias_instability" not in line)
    return check_plan(
        Document(campaign.plan.encode(), "world.yaml"), Document(bench.encode(), "world.bench.yaml")
    ).sound()


def recorded(campaign: Campaign, world: World, draw: np.random.Generator) -> tuple[dict[str, float], Recorded]:
    """A device's truth, and what it puts out in this world."""
    device = campaign.device(draw)
    steps = campaign.steps
    tilts = world.tilt * draw.standard_normal((len(steps), 3)) if world.tilt else None
    rates = world.rate * draw.standard_normal(len(steps)) if world.rate else None
    if not world.anew:
        tilts = None if tilts is None else tilts[_first([step.axes for step in steps])]
        rates = None if rates is None else rates[_first([step.rate for step in steps])]
    seen = felt(steps, campaign.sampling, tilts, rates)
    values = device.outputs(seen) + campaign.white * draw.standard_normal((len(seen.time), len(campaign.white)))
    share = (seen.time - seen.time[0]) / (seen.time[-1] - seen.time[0])
    course = world.celsius or campaign.celsius
    celsius = None if course is None else course(share)
    made = Recorded(
        seen.time, seen.step, values, campaign.white, campaign.mean, campaign.sampling, celsius, campaign.signed
    )
    return dict(device.truth), made if world.fault is None else replace(made, values=world.fault(made, draw))


def _first(states: Sequence[object]) -> list[int]:
    """For each state, the number of the first one that is equal to it."""
    return [states.index(one) for one in states]


def estimated(campaign: Campaign, sound: Sound, made: Recorded) -> Estimate | str:
    """What planrunner makes of it, or why nothing."""
    segments = {segment.label: segment for segment in sound.schedule.segments}
    recording = [segment_of(segments[step.label], made, number, campaign) for number, step in enumerate(campaign.steps)]
    results = analyse(sound.plan.estimates, (), recording, sound.models.site, sound.sensor, sound.setup)
    return results.estimates.get(campaign.estimate) or results.failures[campaign.estimate]


def segment_of(segment: Segment, made: Recorded, number: int, campaign: Campaign) -> RecordedSegment:
    """The recording of the step with this number."""
    rows = made.step == number
    time, values = made.time[rows], made.values[rows]
    channels = {name: values[:, k] for k, name in enumerate(campaign.channels)}
    units = dict(campaign.channels)
    if made.celsius is not None:
        channels[THERMOMETER], units[THERMOMETER] = made.celsius[rows], "degC"

    def blocks(names: Sequence[str]) -> Iterator[Block]:
        for low in range(0, len(time), BLOCK):
            yield Block(time[low : low + BLOCK], {name: channels[name][low : low + BLOCK] for name in names})

    statistics = statistics_of(blocks(tuple(channels)), tuple(channels), len(time), motion=segment.motion)
    return RecordedSegment(segment, units, statistics, blocks)


@dataclass(frozen=True, slots=True)
class Batch:
    """Runs of a campaign in a world, both by name, that a worker simulates together. first: number of the first run."""

    campaign: str
    world: str
    runs: int
    first: int


def tally_of(seed: int, batch: Batch) -> Tally:
    """With one thread of linear algebra, so that the digits do not depend on the processors."""
    with threadpool_limits(limits=1, user_api="blas"):
        return tally(CAMPAIGNS[batch.campaign], world_of(batch.campaign, batch.world), batch.runs, seed, batch.first)


def world_of(campaign: str, world: str) -> World:
    """With the cause that this campaign can name."""
    asked = WORLDS[world]
    return replace(asked, cause=CAMPAIGNS[campaign].causes.get(world, asked.cause))


def tally(campaign: Campaign, world: World, runs: int, seed: int, first: int = 0) -> Tally:
    """Of `runs` recordings, the first of which has the number `first`: each number has its own random draws."""
    sound, found = known(campaign, world), Tally()
    for run in range(first, first + runs):
        truth, made = recorded(campaign, world, np.random.default_rng([seed, run]))
        one = estimated(campaign, sound, made)
        found.runs += 1
        if isinstance(one, str):
            found.failed.append(one)
            found.named += bool(world.cause) and world.cause in one
            continue
        found.warned += bool(one.warnings)
        found.named += bool(world.cause) and any(world.cause in text for text in one.warnings)
        inside = []
        for item in one.coefficients:
            if item.name in truth:
                u = item.standard_uncertainty
                error = item.value - truth[item.name]
                if np.isfinite(item.period):
                    error -= item.period * np.round(error / item.period)
                inside.append(abs(error) <= expanded_uncertainty(u, item.degrees_of_freedom))
                found.held[item.name] = found.held.get(item.name, 0) + bool(inside[-1])
                found.squares[item.name] = found.squares.get(item.name, 0.0) + float(error / u) ** 2
        share = float(np.mean(inside))
        found.shares, found.shares_squared = found.shares + share, found.shares_squared + share**2
    return found
