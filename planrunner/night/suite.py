"""Describes a suite as data: the plans that run in a night, their devices, benches and times, and the consequences of a failure.

As for plans and benches, the code that reads suites, the JSON Schema in `schemas/` and the key reference in `docs/` are all derived
from these records.
"""

from __future__ import annotations

from planrunner.base.findings import Findings
from planrunner.bench.calibration import LINE
from planrunner.plan import source
from planrunner.plan.kinds import (
    Boolean,
    Choice,
    ListOf,
    MapOf,
    Number,
    QuantityOf,
    Record,
    RecordOf,
    Text,
    key,
    optional,
)
from planrunner.plan.model import PERSON
from planrunner.plan.parameters import NAME as PARAMETER
from planrunner.plan.parameters import VALUE
from planrunner.plan.quantity import Quantity, parse_quantity
from planrunner.plan.segments import NAME

HEADER = "planrunner_suite"
"""Key by which a suite is recognised; no other file has it."""
DEVICE = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,59}"
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
_PATH = r"[^\x00-\x1f]{1,200}"
_TIME = Text(
    r"([01][0-9]|2[0-3]):[0-5][0-9]", "a time of day", 'write hours and minutes in quotes, for example "22:00"'
)
_INFORMATION = MapOf(Text(LINE, "a text on one line"), pattern=NAME)
_VARIABLE = Text(
    r"[A-Z][A-Z0-9_]{0,79}",
    "the name of an environment variable",
    "capital letters, digits and _, for example SMTP_PASSWORD",
)


class NightWindow(Record):
    """The hours of the day in which tests may run."""

    opens: str = key(_TIME, "Local time at which the window opens.", "22:00", name="from")
    closes: str = key(
        _TIME,
        "Local time at which every test must have ended; on the next day if it is not later than `from`.",
        "06:00",
        name="to",
    )
    days: tuple[str, ...] = key(
        ListOf(Choice(DAYS), minimum=1),
        "Days on which the window opens.",
        ["mon", "tue", "wed", "thu", "fri"],
        default=DAYS,
    )


class StandardOverride(Record):
    """Permits tests on this bench to run although its check standard is not in control."""

    by: str = key(
        Text(PERSON, "a person's name"),
        "The person who decides that the tests may run: a name in `may_override` of the bench file.",
        "anna",
    )
    why: str = key(
        Text(LINE, "a reason"),
        "Reason for this decision; it is stored with every run.",
        "table was levelled, certificate follows",
    )


class SuiteBench(Record):
    """A bench of the night. Benches work in parallel."""

    bench: str = key(Text(_PATH, "a bench's name or file"), "The name of a shipped bench, or a file.", "virtual")
    warm_up: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "Waiting time before the first test on this bench, for example until a chamber or a sensor has its working temperature. Later "
        "tests on this bench do not wait again.",
        "45 min",
    )
    stays_warm: Quantity | None = optional(
        QuantityOf("time", "positive"),
        "The warm-up is repeated if the bench has been idle for longer than this time; by default it is not repeated.",
        "2 h",
    )
    check_standard_first: bool = key(
        Boolean(),
        "Measures the check standard of the bench before all other tests. If it is then not in control, no other test runs on this bench.",
        True,
        default=False,
    )
    override_check_standard: StandardOverride | None = optional(
        RecordOf(StandardOverride),
        "Lets tests run although the check standard is not in control.",
        {"by": "anna", "why": "table was levelled"},
    )
    window: NightWindow | None = optional(
        RecordOf(NightWindow),
        "Hours in which this bench may be used. A test on this bench must fit into these hours and into the hours of the suite.",
        {"from": "20:00", "to": "23:30"},
    )


class SuiteDevice(Record):
    """A device under test."""

    benches: tuple[str, ...] = key(
        ListOf(Text(NAME, "a bench's name"), single=True, minimum=1),
        "Benches of the suite that the device is mounted on; by default all.",
        "a",
        default_factory=tuple,
    )
    set: dict[str, str] = key(
        _INFORMATION,
        "Run information of this device, for the plans that ask for it.",
        {"device_serial": "FG-0007"},
        default_factory=dict,
    )
    seed: int | None = optional(
        Number(0, 2**63 - 1, integer=True),
        "Seed of a simulated bench when this device is tested; by default that of the bench.",
        7,
    )


class SuitePlan(Record):
    """A plan of the night. The plan runs once for each device, bench, and combination of `matrix` and `parameters`."""

    plan: str = key(
        Text(_PATH, "a plan file"), "The plan, relative to the suite.", "../flexure_gyro_eight_position.yaml"
    )
    devices: tuple[str, ...] = key(
        ListOf(Text(DEVICE, "a device's name"), single=True, minimum=1),
        "Devices to test; by default all.",
        ["FG-0007", "FG-0008"],
        default_factory=tuple,
    )
    benches: tuple[str, ...] = key(
        ListOf(Text(NAME, "a bench's name"), single=True, minimum=1),
        "Benches of the suite to use; by default all.",
        "a",
        default_factory=tuple,
    )
    set: dict[str, str] = key(
        _INFORMATION, "Run information, as with `planrunner run --set`.", {"work_order": "WO-117"}, default_factory=dict
    )
    matrix: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(Text(LINE, "a text on one line"), minimum=1, maximum=100), pattern=NAME),
        "Run information with several values: the plan runs once for each combination.",
        {"fixture": ["FX-1", "FX-2"]},
        default_factory=dict,
    )
    parameters: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(Text(VALUE, "a value"), single=True, minimum=1, maximum=100), pattern=PARAMETER),
        "Values for parameters of the plan (its values with an anchor, such as `dwell: &dwell 2 min`): the plan runs once for each "
        "combination.",
        {"dwell": ["1 min", "5 min"]},
        default_factory=dict,
    )
    after: tuple[str, ...] = key(
        ListOf(Text(NAME, "a plan's name"), single=True),
        "Plans of the suite that must have ended before this plan begins, whatever their result.",
        "drift",
        default_factory=tuple,
    )
    needs: tuple[str, ...] = key(
        ListOf(Text(NAME, "a plan's name"), single=True),
        "Plans of the suite that must have passed; otherwise this plan does not run.",
        "drift",
        default_factory=tuple,
    )
    warm: bool = key(Boolean(), "Whether the plan needs the bench's warm-up.", False, default=True)
    retries: int = key(
        Number(0, 10, integer=True),
        "How often a test is repeated after a failure of a kind in `retry_on`.",
        2,
        default=0,
    )
    retry_on: tuple[str, ...] = key(
        ListOf(Choice(("fault", "limit")), minimum=1),
        "Failures after which a test is repeated: `fault` continues the interrupted run; `limit` makes a new run.",
        ["fault", "limit"],
        default=("fault",),
    )
    retry_after: Quantity = key(
        QuantityOf("time", "not negative"),
        "Waiting time before a repetition.",
        "5 min",
        default=parse_quantity("1 min"),
    )
    interrupted: str = key(
        Choice(("resume", "retake")),
        "What happens to an incomplete run when the night continues after a power failure: `resume` continues it, `retake` makes a "
        "new run.",
        "retake",
        default="resume",
    )
    on_limit: str = key(
        Choice(("continue", "stop_device", "stop_bench", "stop_night")),
        "What happens after a failed limit: the night goes on, or no further test begins on this device, on this bench, or at all.",
        "stop_device",
        default="continue",
    )
    on_fault: str = key(
        Choice(("continue", "stop_device", "stop_bench", "stop_night")),
        "What happens after a fault that remains after all repetitions (`retries`), with the same choices as `on_limit`.",
        "stop_night",
        default="stop_bench",
    )


class KnownFailure(Record):
    """A known failure that, until a stated date, does not make the night fail."""

    tests: tuple[str, ...] = key(
        ListOf(Text(r"[^\x00-\x1f]{1,200}", "a test's name or pattern"), single=True, minimum=1),
        "Names of tests, or patterns with the wildcards * and ?.",
        "drift/FG-0007/*",
    )
    until: str = key(
        Text(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", "a date", 'write the date in quotes, for example "2026-12-31"'),
        "Last day on which the failure counts as known.",
        "2026-12-31",
    )
    reason: str = key(
        Text(LINE, "a reason"), "Cause of the failure; the summary shows it.", "connector worn, replacement ordered"
    )
    of: tuple[str, ...] = key(
        ListOf(Choice(("limit", "fault")), minimum=1), "Kinds of failure that are known.", ["limit"], default=("limit",)
    )


class NightDiagnosis(Record):
    """Declares a diagnosis after the night: the runs of the night, together with recent runs of the same plans."""

    recent: int = key(
        Number(4, 400, integer=True),
        "Largest number of runs of each plan that are diagnosed together: the runs of the night, and the newest earlier runs.",
        60,
        default=40,
    )
    within: Quantity = key(
        QuantityOf("time", "positive"),
        "Runs older than this time are not used.",
        "90 d",
        default=parse_quantity("1440 h"),
    )


class Notification(Record):
    """Declares a message at the end of the night: either `webhook` or `email`."""

    webhook: str | None = optional(
        Text(r"https?://[^\s\x00-\x1f]{1,400}", "an http or https address"),
        "Address that receives the summary as JSON (POST).",
        "https://chat.example.org/hooks/lab",
    )
    webhook_from: str | None = optional(
        _VARIABLE, "Environment variable with the address, if the address is secret.", "LAB_HOOK"
    )
    secret_from: str | None = optional(
        _VARIABLE,
        "Environment variable with a key; the header X-Planrunner-Signature then has the HMAC-SHA-256 of the body.",
        "LAB_HOOK_KEY",
    )
    email: tuple[str, ...] = key(
        ListOf(Text(r"[^\s@,;<>]{1,64}@[^\s@,;<>]{1,190}", "an e-mail address"), single=True),
        "Addresses that receive the summary.",
        ["lab@example.org"],
        default_factory=tuple,
    )
    sender: str | None = optional(
        Text(r"[^\s@,;<>]{1,64}@[^\s@,;<>]{1,190}", "an e-mail address"),
        "Sender of the e-mail.",
        "planrunner@example.org",
        name="from",
    )
    server: str = key(
        Text(r"[A-Za-z0-9._-]{1,190}(:[0-9]{1,5})?", "a host, or host:port"),
        "SMTP server.",
        "smtp.example.org:587",
        default="localhost:25",
    )
    security: str = key(
        Choice(("starttls", "tls", "none")),
        "Encryption of the connection to the server.",
        "starttls",
        default="starttls",
    )
    user: str | None = optional(Text(LINE, "a user's name"), "User name at the server.", "planrunner")
    password_from: str | None = optional(_VARIABLE, "Environment variable with the password.", "SMTP_PASSWORD")
    when: str = key(
        Choice(("always", "failed")),
        "Whether to notify after every night, or only after a night that failed.",
        "failed",
        default="always",
    )


class Suite(Record):
    """A suite: the plans of a night."""

    planrunner_suite: int = key(Number(1, 1, integer=True), "Version of the suite language.", 1, fallback=1)
    title: str = key(
        Text(r"[^\x00-\x1f]{1,200}", "a title"),
        "One line that describes the night.",
        "Gyro laboratory, every night",
        fallback="",
    )
    description: str = key(
        Text(), "Purpose of the night, for reviewers.", "Drift of all gyros on both benches.", default=""
    )
    zone: str | None = optional(
        Text(r"[A-Za-z0-9_+/-]{1,60}", "a time zone"),
        "Time zone of the times of day (IANA name); by default that of the computer.",
        "Europe/Berlin",
    )
    window: NightWindow | None = optional(
        RecordOf(NightWindow),
        "Hours of the night; without it, the night begins at once and has no end.",
        {"from": "22:00", "to": "06:00"},
    )
    budget: Quantity | None = optional(
        QuantityOf("time", "positive"), "Longest duration of the night; a test that does not fit is not begun.", "8 h"
    )
    set: dict[str, str] = key(
        _INFORMATION, "Run information for all plans that ask for it.", {"operator": "night"}, default_factory=dict
    )
    benches: dict[str, SuiteBench] = key(
        MapOf(RecordOf(SuiteBench), pattern=NAME),
        "The benches, each under a name of your choice.",
        {"a": {"bench": "virtual"}},
        fallback={},
    )
    devices: dict[str, SuiteDevice] = key(
        MapOf(RecordOf(SuiteDevice), pattern=DEVICE),
        "The devices by name. Without devices, each plan runs once on each bench.",
        {"FG-0007": {"benches": "a"}},
        default_factory=dict,
    )
    plans: dict[str, SuitePlan] = key(
        MapOf(RecordOf(SuitePlan), pattern=NAME),
        "The plans, each under a name of your choice. On each bench, the first test that can run is begun, in the order of this list.",
        {"drift": {"plan": "../flexure_gyro_eight_position.yaml"}},
    )
    known_failures: tuple[KnownFailure, ...] = key(
        ListOf(RecordOf(KnownFailure)),
        "Failures that do not make the night fail (quarantine).",
        [{"tests": "drift/FG-0007/*", "until": "2026-12-31", "reason": "connector worn"}],
        default_factory=tuple,
    )
    diagnosis: NightDiagnosis | None = optional(
        RecordOf(NightDiagnosis),
        "Diagnosis of the runs after the night; without this key, they are not diagnosed.",
        {"recent": 40},
    )
    notify: tuple[Notification, ...] = key(
        ListOf(RecordOf(Notification), maximum=20),
        "Messages at the end of the night.",
        [{"webhook_from": "LAB_HOOK", "when": "failed"}],
        default_factory=tuple,
    )


SECTIONS: tuple[tuple[str, str, type[Record]], ...] = (
    ("A suite", "The top of the file.", Suite),
    ("`window`", "", NightWindow),
    ("`benches`: each bench", "", SuiteBench),
    ("`benches`: `override_check_standard`", "", StandardOverride),
    ("`devices`: each device", "", SuiteDevice),
    ("`plans`: each plan", "", SuitePlan),
    ("`known_failures`", "", KnownFailure),
    ("`diagnosis`", "", NightDiagnosis),
    ("`notify`", "", Notification),
)
"""Title, text and record of each section of the reference of keys."""


def read_suite(root: source.Mapping, log: Findings) -> Suite | None:
    """Reads the suite in a document as far as possible; adds findings to `log`. Returns None if the suite cannot be read."""
    suite: Suite | None = RecordOf(Suite).read(root, log)
    return suite
