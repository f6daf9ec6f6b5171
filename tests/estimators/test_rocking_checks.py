"""What `check` says of rocking tests before they run: each finding provoked by one change to the shipped plan or its bench."""

from __future__ import annotations

from pathlib import Path

import pytest

from planrunner.tasks.check import Checked, check_plan

ROOT = Path(__file__).resolve().parents[2]
PLAN = (ROOT / "plans" / "platform_rocking.yaml").read_text(encoding="utf-8")
BENCH = (ROOT / "plans" / "benches" / "virtual_platform.yaml").read_text(encoding="utf-8")


def checked(folder: Path, *changes: tuple[str, str], bench: tuple[str, str] | None = None) -> Checked:
    """The shipped plan with texts replaced, each of which must be there, on its bench."""
    text = PLAN
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "plan.yaml").write_text(text, encoding="utf-8")
    table = BENCH
    if bench is not None:
        assert bench[0] in table
        table = table.replace(*bench)
    (folder / "bench.yaml").write_text(table, encoding="utf-8")
    return check_plan(folder / "plan.yaml", bench=folder / "bench.yaml")


def rocking(found: Checked) -> list[tuple[str, str, str]]:
    return [(f.code, f.severity, f.message) for f in found.findings if f.code.startswith("physics-rocking")]


def test_the_shipped_plan_is_sound(tmp_path):
    found = checked(tmp_path)
    assert list(found.findings) == []
    design = found.designs["rocking"]
    assert [item.name for item in design.predicted][:3] == ["drift_x", "drift_y", "drift_z"]
    # one count of 2.5 g/2^21 = 1.192 µg is 0.246 arcsec, which 0.003 deg/h = 0.003 arcsec/s moves in 82 s
    assert "1.19 µg, 0.246 arcsec" in design.notes[0]
    assert "takes 82 s" in design.notes[0]


ERROR, WARNING = "error", "warning"
FOR = "for: 8 min"
OTHERWISE = "{rock: {amplitude: 2 deg, frequency: 0.2 Hz, phases: [0 deg, 45 deg]}, for: 8 min}"
HORIZONTAL = ("        horizontal: {x: up, y: south, z: east}\n", "")
LIMIT_Y = ("  - {quantity: rocking.drift_y, within: ±0.05 deg/h}\n", "")
TILTED = "vertical: {from: {x: north, y: up}, rotate: [x 10 deg]}"


def also(key: str) -> list[tuple[str, str]]:
    """One more key of the estimate."""
    return [("window: 2 s", f"window: 2 s\n    {key}")]


@pytest.mark.parametrize(
    ("code", "severity", "changes", "words"),
    [
        ("release", WARNING, [("release: 60 s", "release: 30 s")], "30 s after release"),
        ("window", WARNING, [("window: 2 s", "window: 1 s")], "shorter than the 2 s"),
        ("dwell", ERROR, [("dwell: 10 min", "dwell: 61 s"), (FOR, "for: 10 s")], "does not follow the first, which ends at 62 s"),
        ("end", ERROR, [(FOR, "for: 599 s")], "rocks as long as it records"),
        ("end", ERROR, [(FOR, "for: 594 s")], "until 599 s"),
        ("duration", WARNING, [(FOR, "for: 9 min")], "rocks for 9 min"),
        ("phases", WARNING, [("45 deg, 90 deg", "45 deg, 80 deg")], "(0, 45, 80 deg) are not equally spaced"),
        ("phases", WARNING, [("45 deg, 90 deg", "60 deg, 120 deg")], "more than 45 deg"),
        ("timing", ERROR, [("{label: static-2}", "{label: static-2, dwell: 9 min}")], "a different timing from 'r1/vertical/static-1'"),
        ("timing", ERROR, [("dynamic-2, motion: *rocking", f"dynamic-2, motion: {OTHERWISE}")], "rocks differently"),
        ("pattern", ERROR, [("      - {label: static-2}\n", "")], "must have the same orientation"),
        ("caging", ERROR, [("      - {label: cage-2, mode: caged, dwell: 10 s}\n", "")], "before 'r1/vertical/dynamic-1' and 5 more"),
        ("caging", WARNING, [('segments: "*"', "segments: [static-*, dynamic-*]")], "cannot be determined"),
        ("dwell", ERROR, also("second_window: 599 s"), "the second window ends at 601 s, after the record of 600 s"),
        ("end", ERROR, also("second_window: 400 s"), "still rocks when its second window begins at 400 s"),
        ("axes", WARNING, [HORIZONTAL, LIMIT_Y], "y is vertical in every state"),
        ("filter", WARNING, also("cutoff: 0.2 Hz"), "passes 50 % of the rocking at 0.2 Hz"),
        ("filter", ERROR, also("cutoff: 1e-12 Hz"), "averages over 1e+12 s, but the windows are only 536 s apart"),
        ("encoders", ERROR, also("gimbal_axes: [x, x, x]"), "turn about the same axis (x, x, x)"),
        ("encoders", ERROR, also("rings: [table_outer, table_middle]"), "`rings` names 2 channels, but the table has 3"),
        ("resolution", WARNING, also("smallest_drift: 0.0004 deg/h"), "takes 615 s, but the time between the windows is 538 s"),
    ],
)  # fmt: skip
def test_each_finding(tmp_path, code, severity, changes, words):
    found = rocking(checked(tmp_path, *changes))
    told = [item for item in found if item[0] == f"physics-rocking-{code}"]
    assert [item[1] for item in told] == [severity]
    assert words in told[0][2]
    # rocking until the end is too long as well
    assert {item[0] for item in found if item not in told} <= ({"physics-rocking-duration"} if code == "end" else set())


def test_the_coarse_range_is_reported(tmp_path):
    """40 g/2^21 = 19.1 µg of standard gravity is 3.94 arcsec here: 1310 s at 0.003 deg/h."""
    found = checked(tmp_path, bench=("range: 1.25 g", "range: 20 g"))
    assert [item[:2] for item in rocking(found)] == [("physics-rocking-resolution", "warning")]
    assert "a change of one count (19.1 µg, 3.94 arcsec) takes 1.31e+03 s" in rocking(found)[0][2]
    hints = [finding.hint for finding in found.findings]
    assert hints == ["use the accelerometers' 1.25 g range"]


def test_a_cutoff_that_the_sampling_is_too_slow_for_is_refused(tmp_path):
    found = rocking(checked(tmp_path, *also("cutoff: 26 Hz")))
    assert [words for _, severity, words in found if severity == ERROR] == [
        "'rocking': a cutoff of 26 Hz needs 104 samples per second, but the plan has 100"
    ]


def test_findings_stand_at_their_keys(tmp_path):
    found = checked(tmp_path, ("release: 60 s", "release: 30 s"))
    line = PLAN[: PLAN.index("release: 60 s")].count("\n") + 1
    assert [finding.mark.line for finding in found.findings] == [line]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([("vertical: {x: north, y: up, z: east}", TILTED)], "no axis along the vertical"),
        ([("{label: static-1}", "{label: static-1, rate: 1 deg/s}")], "spins or indexes"),
        ([('segments: "*"', "segments: cage-*")], "none of the chosen segments is a run"),
        (also("accelerometers: [a, accel_y, accel_z]"), "no output 'a'"),
    ],
)  # fmt: skip
def test_what_is_no_rocking_test_is_an_error(tmp_path, changes, words):
    found = checked(tmp_path, *changes)
    assert found.findings.errors
    assert any(words in finding.message for finding in found.findings.errors)


def test_a_limit_on_an_axis_that_is_not_seen_is_an_error(tmp_path):
    found = checked(tmp_path, ("        horizontal: {x: up, y: south, z: east}\n", ""))
    assert {"meaning-unknown-quantity", "physics-rocking-axes"} <= {finding.code for finding in found.findings}


@pytest.mark.parametrize(
    "change",
    [
        "window: -5 s",
        "window: 60",
        "window: 2 s\n    cutoff: 0.05",
        "window: 2 s\n    azimuth: magnetic",
        "window: 2 s\n    gimbal_axes: [x, y]",
    ],
)
def test_keys_that_make_no_sense_are_refused_at_their_line(tmp_path, change):
    found = checked(tmp_path, ("window: 2 s", change))
    last = PLAN[: PLAN.index("window: 2 s")].count("\n") + 1 + change.count("\n")
    assert [
        finding.mark.line for finding in found.findings.errors if not finding.code.startswith("meaning-unknown")
    ] == [last]
