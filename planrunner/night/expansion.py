"""Makes the tests of a suite. Each plan is run on each device and bench, with each combination of values of its matrix. Also
determines the other tests for which each test waits."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import date
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark, closest
from planrunner.night.suite import KnownFailure, Suite, SuiteDevice, SuitePlan
from planrunner.plan.parameters import Given
from planrunner.plan.run_information import DEVICE

MOST_TESTS = 1000
_Value = TypeVar("_Value")


Measurement = tuple[Path, str, tuple[tuple[str, str], ...]]
"""A plan file, a bench, and the values for parameters of the plan."""


@dataclass(frozen=True, slots=True)
class PlannedTest:
    """Describes one test of a night, which is one run of a plan.

    `name`: unique name of the test, such as `drift/FG-0007/a` or `drift/FG-0007/a/fixture=FX-1,dwell=2 min`. `entry`: name of the
    plan in the suite file. `matrix`: run information from the matrix. `parameters`: values for parameters of the plan.
    `information`: all run information that the suite gives for the test, including information that the plan does not request.
    `after`: indices of the tests that must have ended before this test begins. `needs`: indices of the tests that must have passed
    before this test begins. `mark`: position in the suite file of the entry from which the test is made. `standard`: True if the
    test measures the check standard of its bench.
    """

    index: int
    name: str
    entry: str
    plan: SuitePlan
    file: Path
    bench: str
    device: str | None
    matrix: Mapping[str, str]
    parameters: Mapping[str, Given]
    information: Mapping[str, str]
    seed: int | None
    mark: Mark
    after: tuple[int, ...] = ()
    needs: tuple[int, ...] = ()
    standard: bool = False

    @property
    def values(self) -> dict[str, str]:
        """Returns the values that distinguish the test from other tests of its plan with this device on this bench."""
        return {**self.matrix, **self.parameter_values}

    @property
    def parameter_values(self) -> dict[str, str]:
        return {name: given.value for name, given in self.parameters.items()}

    @property
    def measurement(self) -> Measurement:
        """Returns a key that is equal for tests with the same plan file, bench and parameter values. These tests share data, which
        are checked only once."""
        return self.file, self.bench, tuple(self.parameter_values.items())


@dataclass(frozen=True, slots=True)
class StandardFirst:
    """Describes a check standard that is measured before the other tests of its bench. `file`: file of the plan that measures the
    check standard. `blocks`: True if the other tests of the bench need the check standard to be in control."""

    device: str
    file: Path
    blocks: bool


CHECK_STANDARD = "check standard"
"""Name of the plan in the tests that measure a check standard. No plan in a suite can have this name."""


def expand_suite(
    suite: Suite, folder: Path, log: Findings, standards: Mapping[str, StandardFirst] = MappingProxyType({})
) -> tuple[PlannedTest, ...]:
    """Makes the tests of a suite: first the tests that measure check standards, then all other tests in the order of the file.
    `folder`: folder of the suite. `standards`: maps each bench whose check standard is measured first to the description of this
    check standard. Unknown names, plans that wait for each other, and plans without a test become findings."""
    before = log.raised
    _check_names(suite, log)
    _check_cycles(suite, log)
    if log.raised > before:
        return ()
    found = [_of_standard(suite, index, bench, standards[bench]) for index, bench in enumerate(standards)]
    first = {test.bench: test.index for test in found}
    for entry, plan in suite.plans.items():
        # The combinations are counted before they are made: there may be very many.
        combinations = math.prod(map(len, (*plan.matrix.values(), *plan.parameters.values())))
        tests = [] if combinations > MOST_TESTS else list(_tests_of(entry, suite, folder, len(found)))
        if max(combinations, len(found) + len(tests)) > MOST_TESTS:
            largest = "parameters" if plan.parameters else "matrix"
            at = plan.at(largest) if combinations > 1 else plan.origin.mark
            what = f"'{entry}' has {combinations} combinations of values; " if combinations > 1 else ""
            hint = "use fewer values in `matrix` and `parameters`, or divide the suite"
            log.error("suite-size", at, f"{what}the suite has more than {MOST_TESTS} tests", hint)
            return ()
        if not tests:
            message = f"'{entry}' has no test: none of its devices is mounted on one of its benches"
            log.error("suite-no-test", plan.origin.mark, message, "change `devices` or `benches`")
        found += tests
    groups: dict[tuple[str | None, ...], list[int]] = {}
    for test in found:
        for group in ((test.entry,), (test.entry, test.device), (test.entry, test.device, test.bench)):
            groups.setdefault(group, []).append(test.index)
    return tuple(
        replace(
            test,
            after=(*standard, *_waited_for(test, (*test.plan.after, *test.plan.needs), groups)),
            needs=(*needed, *_waited_for(test, test.plan.needs, groups)),
        )
        for test in found
        for standard in [() if test.standard or test.bench not in first else (first[test.bench],)]
        for needed in [standard if standard and standards[test.bench].blocks else ()]
    )


def _of_standard(suite: Suite, index: int, bench: str, about: StandardFirst) -> PlannedTest:
    """Returns the test that measures the check standard of a bench."""
    plan, mark = SuitePlan(plan=about.file.name), suite.benches[bench].at("check_standard_first")
    information = {**suite.set, **dict.fromkeys(DEVICE, about.device)}
    name = f"{CHECK_STANDARD}/{about.device}/{bench}"
    return PlannedTest(
        index,
        name,
        CHECK_STANDARD,
        plan,
        about.file,
        bench,
        about.device,
        {},
        {},
        information,
        None,
        mark,
        standard=True,
    )


def _tests_of(entry: str, suite: Suite, folder: Path, first: int) -> Iterator[PlannedTest]:
    plan = suite.plans[entry]
    devices: Sequence[str | None] = plan.devices or tuple(suite.devices) or (None,)
    matrices = list(_combinations(plan.matrix))
    variants = list(
        _combinations(
            {
                name: [
                    Given(value, plan.at(f"parameters.{name}[{place}]" if len(values) > 1 else f"parameters.{name}"))
                    for place, value in enumerate(values)
                ]
                for name, values in plan.parameters.items()
            }
        )
    )
    index = first
    for device in devices:
        about = None if device is None else suite.devices[device]
        mounted: Collection[str] = suite.benches if about is None or not about.benches else about.benches
        for bench in plan.benches or tuple(suite.benches):
            if bench not in mounted:
                continue
            for matrix, parameters in product(matrices, variants):
                words = [entry, *([] if device is None else [device]), bench]
                if matrix or parameters:
                    shown = {**matrix, **{name: given.value for name, given in parameters.items()}}
                    words.append(",".join(f"{name}={value}" for name, value in shown.items()))
                information = {**suite.set, **({} if about is None else about.set), **plan.set, **matrix}
                yield PlannedTest(
                    index,
                    "/".join(words),
                    entry,
                    plan,
                    folder / plan.plan,
                    bench,
                    device,
                    matrix,
                    parameters,
                    information,
                    None if about is None else about.seed,
                    plan.origin.mark,
                )
                index += 1


def _combinations(choices: Mapping[str, Sequence[_Value]]) -> Iterator[dict[str, _Value]]:
    for values in product(*choices.values()):
        yield dict(zip(choices, values, strict=True))


def _waited_for(
    test: PlannedTest, entries: Sequence[str], groups: Mapping[tuple[str | None, ...], Sequence[int]]
) -> tuple[int, ...]:
    """Returns the tests of other plans for which a test waits. For each of these plans, the tests with the same device and bench
    are returned. If there are none, the tests with the same device are returned. If there are no such tests either, all tests of
    the plan are returned. `groups`: maps (plan,), (plan, device) and (plan, device, bench) to the tests with these properties."""
    found: list[int] = []
    for entry in dict.fromkeys(entries):
        here, of_device = groups.get((entry, test.device, test.bench)), groups.get((entry, test.device))
        found += here or of_device or groups.get((entry,), ())
    return tuple(dict.fromkeys(found))


def _check_names(suite: Suite, log: Findings) -> None:
    if not suite.benches and "benches" not in suite.origin.broken and suite.origin.parts("benches"):
        hint = "add for example `a: {bench: virtual}`"
        log.error("suite-no-bench", suite.at("benches"), "the suite has no bench", hint)
    with log.resting_on(*suite.origin.parts("benches")):
        owners: list[SuiteDevice | SuitePlan] = [*suite.devices.values(), *suite.plans.values()]
        for owner in owners:
            for name, hint in _unknown(owner.benches, suite.benches, "benches"):
                log.error("suite-unknown-bench", owner.at("benches"), f"the suite has no bench '{name}'", hint)
    with log.resting_on(*suite.origin.parts("devices")):
        for plan in suite.plans.values():
            for name, hint in _unknown(plan.devices, suite.devices, "devices"):
                log.error("suite-unknown-device", plan.at("devices"), f"the suite has no device '{name}'", hint)
    for plan in suite.plans.values():
        _check_values(plan, log)
        for key, names in (("after", plan.after), ("needs", plan.needs)):
            for name, hint in _unknown(names, suite.plans, "plans"):
                log.error("suite-unknown-plan", plan.at(key), f"the suite has no plan '{name}'", hint)


def _check_values(plan: SuitePlan, log: Findings) -> None:
    """Reports a value that is given twice, and a name that is in both `matrix` and `parameters`. Either fault would give two tests
    the same name."""
    for key, choices in (("matrix", plan.matrix), ("parameters", plan.parameters)):
        for name, values in choices.items():
            for place, value in enumerate(values):
                if value in values[:place]:
                    message = f"the value '{value[:60]}' of '{name}' is given twice"
                    log.error("suite-duplicate", plan.at(f"{key}.{name}[{place}]"), message, "keep one of them")
    for name in plan.parameters:
        if name in plan.matrix:
            message = f"'{name}' is both in `matrix` and in `parameters`"
            hint = (
                "`matrix` gives run information, `parameters` gives values of the plan: rename the anchor in the plan"
            )
            log.error("suite-duplicate", plan.at(f"parameters.{name}"), message, hint)


def _unknown(names: Sequence[str], known: Collection[str], key: str) -> Iterator[tuple[str, str]]:
    """Reports unknown names, each with a hint. `key`: the key under which the names should be declared."""
    for name in names:
        if name not in known:
            yield name, closest(name, known) or f"declare it under `{key}:`"


def _check_cycles(suite: Suite, log: Findings) -> None:
    """Reports plans that wait for each other, once for each cycle."""
    done: set[str] = set()
    for start in suite.plans:
        path = _cycle_from(suite, start, done)
        if path:
            plan = suite.plans[path[0]]
            key = "needs" if path[1] in plan.needs else "after"
            message = f"these plans wait for each other: {' → '.join(path)}"
            log.error(
                "suite-cycle", plan.at(key), message, f"remove '{path[1]}' here, or another of these dependencies"
            )


def _cycle_from(suite: Suite, start: str, done: set[str]) -> list[str]:
    """Searches for a cycle of plans that wait for each other. The search begins with the plan `start`, and goes from each plan to
    the plans for which it waits; plans in `done` are left out. Returns the cycle; empty if there is none. Adds all plans that the
    search has visited to `done`. The search works without recursion, so that a long chain causes no error."""
    path: list[str] = []
    stack: list[tuple[str, bool]] = [(start, False)]
    while stack:
        name, left = stack.pop()
        if left:
            path.pop()
            done.add(name)
            continue
        if name in path:
            cycle = [*path[path.index(name) :], name]
            done.update(path)
            return cycle
        if name in done or name not in suite.plans:
            continue
        path.append(name)
        stack.append((name, True))
        plan = suite.plans[name]
        stack += [(other, False) for other in (*plan.after, *plan.needs)]
    return []


def known_failure(test: str, failures: Sequence[KnownFailure], kind: str, today: date) -> KnownFailure | None:
    """Returns the known failure in the suite that applies if a test fails in this way (`limit` or `fault`) on this day; None if
    there is none."""
    for entry in failures:
        covered = any(fnmatchcase(test, pattern) for pattern in entry.tests)
        if covered and kind in entry.of and today <= date.fromisoformat(entry.until):
            return entry
    return None


def check_known_failures(suite: Suite, tests: Sequence[PlannedTest], today: date, log: Findings) -> None:
    """Reports known failures that match no test, state a nonexistent date, or have expired."""
    names = [test.name for test in tests]
    for entry in suite.known_failures:
        for position, pattern in enumerate(entry.tests):
            if not any(fnmatchcase(name, pattern) for name in names):
                at = entry.at(f"tests[{position}]")
                log.error(
                    "suite-unknown-test", at, f"no test of the suite matches '{pattern}'", closest(pattern, names)
                )
        try:
            last = date.fromisoformat(entry.until)
        except ValueError:
            log.error("meaning-date", entry.at("until"), f"'{entry.until}' is not a date", "write year-month-day")
            continue
        if last < today:
            message = f"this known failure expired on {entry.until}: it now makes the night fail"
            log.warning(
                "suite-expired", entry.at("until"), message, "remove it, or examine the cause and set a later date"
            )
