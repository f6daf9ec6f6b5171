"""Checks a suite: its form and names, every plan on every bench on which the plan will run, and the timetable."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import field, replace
from datetime import date, datetime, tzinfo
from functools import partial
from pathlib import Path

from planrunner.archive.space import recording_bytes
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Finding, Findings, InputError, Mark, closest
from planrunner.base.workers import Workers, results_of
from planrunner.bench.attendance import check_unattended
from planrunner.bench.model import NAME, Bench, locate, read_bench, runs_on_virtual_clock
from planrunner.night.civil_time import civil, zone_of
from planrunner.night.expansion import Measurement, PlannedTest, StandardFirst, check_known_failures, expand_suite
from planrunner.night.suite import HEADER, Suite, SuiteDevice, read_suite
from planrunner.night.timetable import NightForecast, foresee, night_hours
from planrunner.plan import source
from planrunner.plan.parameters import Given, variant_name
from planrunner.plan.run_information import DEVICE
from planrunner.tasks.check import Checked, Document, check_plan


@dataclass(frozen=True, slots=True)
class PlanOnBench:
    """Contains the result of checking a plan on a bench.

    `seconds`: planned duration, s; None if the length of a recording determines the duration. `size`: largest possible size of the
    run folder, bytes. `asks`: maps the name of each item of run information in the plan to True if the item is required.
    """

    findings: tuple[Finding, ...]
    ok: bool
    virtual: bool = True
    seconds: float | None = None
    size: int = 0
    asks: tuple[tuple[str, bool], ...] = ()


@dataclass(slots=True)
class CheckedSuite:
    """Contains the result of checking a suite: the findings, and the suite as far as it could be read. `virtual`: True if all
    benches have simulated time."""

    file: str
    findings: Findings
    data: bytes = b""
    suite: Suite | None = None
    zone: tzinfo | None = None
    tests: tuple[PlannedTest, ...] = ()
    plans: dict[Measurement, PlanOnBench] = field(default_factory=dict)
    forecast: NightForecast | None = None
    virtual: bool = False

    @property
    def ok(self) -> bool:
        return self.forecast is not None and not self.findings.errors

    @property
    def durations(self) -> tuple[float | None, ...]:
        """Returns the planned duration of each test, s; None if the length of a recording determines it."""
        return tuple(self.plans[test.measurement].seconds for test in self.tests)

    def sound(self) -> SoundSuite:
        """Returns the suite with everything that a night needs. Raises `InputError` with the findings if there are errors."""
        if self.findings.errors or self.suite is None or self.forecast is None:
            raise InputError(self.findings)
        asks = tuple(dict(self.plans[test.measurement].asks) for test in self.tests)
        return SoundSuite(
            self.file, self.findings, self.data, self.suite, self.zone, self.tests, self.durations, asks,
            self.forecast, self.virtual, sum(self.plans[test.measurement].size for test in self.tests),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class SoundSuite:
    """Contains a suite that has passed its checks; `findings` may contain warnings. `asks`: for each test, the run information that
    its plan requests. `size`: largest possible size of all run folders together, bytes."""

    file: str
    findings: Findings
    data: bytes
    suite: Suite
    zone: tzinfo | None
    tests: tuple[PlannedTest, ...]
    durations: tuple[float | None, ...]
    asks: tuple[dict[str, bool], ...]
    forecast: NightForecast
    virtual: bool
    size: int

    def bench_of(self, test: PlannedTest) -> str:
        """Returns the bench of a test, in the form that `planrunner run --bench` accepts."""
        return bench_file(self.suite, self.file, test.bench)


def is_suite(file: Path) -> bool:
    """Returns True if a file is a suite, that is, if it has the key `planrunner_suite`. Returns False for a file that cannot be
    read."""
    try:
        data = source.read_bytes(file)
        # The whole text is parsed only if it contains the key.
        return (
            HEADER.encode() in data and source.parse(source.decode(data, str(file)), str(file)).get(HEADER) is not None
        )
    except InputError:
        return False


def bench_file(suite: Suite, file: str, name: str) -> str:
    """Returns the shipped bench or the path of the bench file to which a name in a suite refers. As in a plan, a name without a
    folder or a file extension refers to a shipped bench."""
    written = suite.benches[name].bench
    return written if re.fullmatch(NAME, written) else str(Path(file).parent / written)


def check_suite(
    file: Path | Document, *, at: str | None = None, workers: Workers | None = None, archive: Path | None = None
) -> CheckedSuite:
    """Performs all checks of a suite before a night. The function raises no error, whatever the files contain.

    `at`: the earliest local time at which the night may begin, in the time zone of the suite (ISO 8601); by default, now.
    `workers`: processes that share the checks of the plans; by default, processes on this computer. `archive`: folder with the runs
    of the check standards; if it is not given, the state of the check standards is not checked.
    """
    checked = CheckedSuite(file.shown if isinstance(file, Document) else str(file), Findings())
    log = checked.findings
    try:
        checked.data = file.data if isinstance(file, Document) else source.read_bytes(file)
        root = source.parse(source.decode(checked.data, checked.file), checked.file, log)
    except InputError as error:
        log.extend(error.findings)
        return checked
    suite = checked.suite = read_suite(root, log)
    if suite is None:
        return checked
    try:
        checked.zone = zone_of(suite.zone, suite.at("zone"))
    except InputError as error:
        log.extend(error.findings)
    _check_notifications(suite, log)
    rules = _rules(suite, checked.file)
    checked.tests = expand_suite(suite, Path(checked.file).parent, log, _standards(suite, rules, log))
    begins = time.time() if at is None else datetime.fromisoformat(at).replace(tzinfo=checked.zone).timestamp()
    today = civil(begins, checked.zone).date()
    if checked.tests:
        check_known_failures(suite, checked.tests, today, log)
    _check_plans(checked, suite, workers or Workers())
    _check_information(checked, suite)
    _check_devices(checked, suite)
    _check_standards(checked, suite, rules, archive)
    if log.errors or not checked.tests:
        return checked
    hours = night_hours(suite, begins, checked.zone)
    checked.forecast = foresee(checked.tests, checked.durations, hours, checked.zone)
    for index, reason in checked.forecast.left_out:
        test = checked.tests[index]
        hint = "leave tests out, widen the window or the budget, or use another bench"
        log.warning("suite-does-not-fit", test.mark, f"{test.name} will not run: {reason}", hint)
    return checked


def _rules(suite: Suite, file: str) -> dict[str, tuple[Bench, Path]]:
    """Returns the benches of the suite that have a check standard. Maps the name of each bench to the bench and the folder of its
    file. Faults of a bench are reported when its plans are checked."""
    found = {}
    for name in suite.benches:
        written = bench_file(suite, file, name)
        try:
            bench = read_bench(written, Path())[0]
        except InputError:
            continue
        if bench.check_standard is not None:
            found[name] = bench, locate(written, Path())[0].parent
    return found


def _standards(suite: Suite, rules: Mapping[str, tuple[Bench, Path]], log: Findings) -> dict[str, StandardFirst]:
    """Maps the name of a bench to its check standard, if the suite measures the check standard before other tests."""
    found = {}
    for name, about in suite.benches.items():
        rule = rules[name][0].check_standard if name in rules else None
        given = about.override_check_standard
        if rule is None:
            for key, stated in (
                ("check_standard_first", about.check_standard_first),
                ("override_check_standard", given),
            ):
                if stated:
                    message = f"bench '{name}' has no check standard"
                    hint = "remove this key, or declare `check_standard` in the bench file"
                    log.error("suite-check-standard", about.at(key), message, hint)
            continue
        if given is not None and given.by not in rule.may_override:
            message = f"'{given.by}' may not override the check standard of this bench"
            hint = closest(given.by, rule.may_override) or "`may_override` in the bench file names who may"
            log.error("bench-check-override", given.at("by"), message, hint)
        elif given is not None:
            from planrunner.tasks.check_standard import Override, signature_of

            try:
                signature_of(rules[name][0], Override(given.by, given.why))
            except InputError as error:
                for finding in error.findings:
                    log.error(finding.code, given.at("by"), finding.message, finding.hint)
        if about.check_standard_first:
            blocks = rule.action == "refuse" and given is None
            found[name] = StandardFirst(rule.device, rules[name][1] / rule.plan, blocks)
    return found


def _check_standards(
    checked: CheckedSuite, suite: Suite, rules: Mapping[str, tuple[Bench, Path]], archive: Path | None
) -> None:
    """Checks the plans that measure a check standard: each of them must record which device it measures. If no test of the suite
    measures the check standard of a bench, also checks that this check standard is in control now."""
    log = checked.findings
    for name, (bench, _) in rules.items():
        rule, own = bench.check_standard, [test for test in checked.tests if test.bench == name]
        assert rule is not None
        measured = [
            test
            for test in own
            if rule.measured_by(variant_name(test.file.stem, test.parameter_values), test.information)
        ]
        for test in measured:
            pair = checked.plans[test.measurement]
            if pair.ok and not dict(pair.asks).keys() & {*DEVICE}:
                message = f"the plan of the check standard does not record {DEVICE[0]}"
                log.error(
                    "suite-check-standard", test.mark, message, f"add `{DEVICE[0]}: required` under `record:` in it"
                )
        if archive is not None and own and not measured and suite.benches[name].override_check_standard is None:
            from planrunner.tasks.check_standard import check_in_control, control_state

            state = control_state(bench, archive)
            if state is not None:
                check_in_control(bench, state, log)


def _check_plans(checked: CheckedSuite, suite: Suite, workers: Workers) -> None:
    """Checks every plan with every combination of its parameters on every bench. Equal cases are checked only once."""
    log = checked.findings
    first: dict[Measurement, PlannedTest] = {}
    for test in checked.tests:
        first.setdefault(test.measurement, test)
    items: list[_Item] = [
        (test.file, bench_file(suite, checked.file, test.bench), test.parameters) for test in first.values()
    ]
    if workers.scheduler is None:
        answers = results_of(_look_at, items, workers)
    else:
        found = results_of(
            partial(_look_elsewhere, date.today()), [(item, item[0], Path(item[1])) for item in items], workers
        )
        answers = [one or _look_at(item) for item, one in zip(items, found, strict=True)]
    checked.plans.update(zip(first, answers, strict=True))
    everywhere: dict[tuple[Path, str], set[Finding]] = {}
    for (file, bench, _), answer in checked.plans.items():
        everywhere.setdefault((file, bench), set(answer.findings)).intersection_update(answer.findings)
    for measurement, test in first.items():
        for finding in checked.plans[measurement].findings:
            if finding.code in ("file-missing", "meaning-unknown-bench", "file-directory"):
                of_bench = finding.mark.file != str(test.file)
                at = suite.benches[test.bench].at("bench") if of_bench else _plan_of(test)
                log.error(finding.code, at, f"{finding.mark.file}: {finding.message}", finding.hint)
            elif finding.severity != "note":
                always = finding in everywhere[test.file, test.bench] or finding.mark.file == checked.file
                log.extend([finding if always else _of_variant(finding, test)])
    used = {test.bench for test in checked.tests}
    checked.virtual = all(answer.virtual for (_, bench, _), answer in checked.plans.items() if bench in used)


def _of_variant(finding: Finding, test: PlannedTest) -> Finding:
    """Returns a finding about a plan, with the values of the plan's parameters added to the text of the finding. The values are
    added because the finding may not occur with other values."""
    values = ", ".join(f"{name} = {value}" for name, value in test.parameter_values.items())
    return replace(finding, message=f"{finding.message} (with {values})")


def _plan_of(test: PlannedTest) -> Mark:
    """Returns the position at which the suite file names the plan of a test."""
    return test.mark if test.standard else test.plan.at("plan")


_Item = tuple[Path, str, Mapping[str, Given]]
"""A plan, a bench, and values for parameters of the plan."""


def _look_elsewhere(today: date, given: tuple[_Item, Path, Path]) -> PlanOnBench | None:
    """Checks a plan on a worker of a cluster. Returns None if the result depends on this computer, so that the plan must be checked
    here. `given`: the case to check, the path of its plan, and the path of its bench."""
    file, bench, parameters = given[0]
    found = check_plan(file, bench, today=today, parameters=parameters)
    return _seen(found) if found.portable else None


def _look_at(item: _Item) -> PlanOnBench:
    file, bench, parameters = item
    return _seen(check_plan(file, bench, parameters=parameters))


def _seen(found: Checked) -> PlanOnBench:
    if found.bench is not None and found.schedule is not None:
        check_unattended(found.bench, found.schedule, found.findings)
    asks = () if found.plan is None else tuple((name, item.required) for name, item in found.plan.record.items())
    if found.schedule is None or found.bench is None or found.models is None or found.models.sensor is None:
        return PlanOnBench(tuple(found.findings), False, asks=asks)
    sensor, schedule = found.models.sensor, found.schedule
    recorded = any(segment.dwell is None for segment in schedule.segments)
    return PlanOnBench(
        tuple(found.findings),
        found.ok,
        runs_on_virtual_clock(found.bench),
        None if recorded else schedule.total,
        recording_bytes(schedule, sensor.sample_rate, len(sensor.outputs) + 1),
        asks,
    )


def _check_information(checked: CheckedSuite, suite: Suite) -> None:
    """Checks that the suite gives the run information that its plans request, and no other information."""
    log = checked.findings
    asked: set[str] = set()
    for test in checked.tests:
        asks = dict(checked.plans[test.measurement].asks)
        asked.update(asks)
        if not checked.plans[test.measurement].ok:
            continue
        for name, required in asks.items():
            if required and name not in test.information:
                message = f"'{test.entry}' asks for '{name}', which the suite does not give"
                log.error(
                    "suite-information-missing",
                    test.mark,
                    message,
                    f"add it under `set:`, for example `set: {{{name}: …}}`",
                )
        for key, given in (("set", test.plan.set), ("matrix", test.plan.matrix)):
            for name in given:
                if name not in asks:
                    at = test.plan.at(f"{key}.{name}")
                    message = f"the plan '{test.entry}' does not ask for '{name}'"
                    log.error(
                        "run-info-unknown", at, message, closest(name, asks) or "add it under record: in the plan"
                    )
    if checked.tests and all(answer.ok for answer in checked.plans.values()):
        owners: list[Suite | SuiteDevice] = [suite, *suite.devices.values()]
        for owner in owners:
            for name in owner.set:
                if name not in asked:
                    message = f"no plan of the suite asks for '{name}'"
                    log.warning("suite-information-unused", owner.at(f"set.{name}"), message, closest(name, asked))


def _check_devices(checked: CheckedSuite, suite: Suite) -> None:
    """Checks that no device is tested on two real benches, because nobody can move the device at night."""
    real = {bench for (_, bench, _), answer in checked.plans.items() if answer.ok and not answer.virtual}
    for name, device in suite.devices.items():
        places = sorted({test.bench for test in checked.tests if test.device == name} & real)
        if len(places) > 1:
            message = f"device '{name}' is tested on {' and '.join(places)}, but nobody moves it at night"
            at = device.at("benches") if device.benches else device.origin.mark
            checked.findings.warning("suite-device-moves", at, message, "name the bench that it is mounted on")


def _check_notifications(suite: Suite, log: Findings) -> None:
    for entry in suite.notify:
        ways = [bool(entry.webhook), bool(entry.webhook_from), bool(entry.email)]
        if sum(ways) != 1:
            hint = "give one of webhook, webhook_from and email; write several entries for several receivers"
            log.error("suite-notification", entry.origin.mark, "a notification goes to exactly one receiver", hint)
        elif entry.email and entry.sender is None:
            log.error(
                "suite-notification",
                entry.origin.mark,
                "an e-mail needs a sender",
                "add for example `from: lab@example.org`",
            )
        elif (entry.user is None) != (entry.password_from is None):
            log.error(
                "suite-notification",
                entry.origin.mark,
                "user and password_from belong together",
                "give both or neither",
            )
        elif entry.password_from is not None and entry.security == "none":
            message = "the password would be sent without encryption"
            log.error("suite-notification", entry.at("security"), message, "use starttls or tls")
