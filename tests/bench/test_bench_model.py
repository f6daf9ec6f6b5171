"""Bench files: what they say, and what is wrong with those that say something else."""

from __future__ import annotations

import json
import math
from pathlib import Path

import jsonschema
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from planrunner.base.findings import InputError
from planrunner.base.shipped import shipped
from planrunner.bench.model import locate, models, parse_bench, read_bench, safe_order, shipped_benches
from planrunner.plan import source
from planrunner.tasks.write_schemas import bench_schema

TABLE = """
  table:
    driver: virtual_table
    axes: [{name: outer, direction: up, max_rate: 100 deg/s, max_acceleration: 50 deg/s^2}]
"""
CARRIER = "\n  ship: {driver: virtual_carrier, speed: 1 m/s}"
CHAMBER = """
  chamber: {driver: virtual_chamber, lowest: -40 degC, highest: 60 degC, ramp: 2 K/min}
"""
HEAD = """planrunner_bench: 1
name: test
clock: virtual
site: {latitude: 40 deg, gravity: 9.80154 m/s^2}
"""


def codes(text: str) -> list[str]:
    _, log = parse_bench(source.parse(text, "b.yaml"))
    return [item.code for item in log.errors]


def findings(text: str) -> str:
    _, log = parse_bench(source.parse(text, "b.yaml"))
    return "\n".join(f"{item} ({item.hint})" for item in log)


def test_the_shipped_benches_are_found_by_name_and_read_without_a_finding():
    assert {"virtual", "rimu_rate_staircase", "rimu_pitch_tumble", "mpu9150_imu0", "mpu9150_imu2"} <= set(
        shipped_benches()
    )
    for name in shipped_benches():
        bench, raw, shown = read_bench(name)
        assert bench.name == name
        assert raw == shipped_benches()[name].read_bytes()
        assert shown == f"plans/benches/{name}.yaml"
        _, log = parse_bench(source.parse(raw.decode(), shown))
        assert list(log) == []


@pytest.mark.parametrize("name", sorted(shipped_benches()))
def test_the_shipped_benches_fit_the_schema(name):
    document = yaml.safe_load(shipped_benches()[name].read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(bench_schema()).validate(json.loads(json.dumps(document)))


def test_the_models_of_the_default_bench():
    given = models(read_bench("virtual")[0])
    assert math.degrees(given.site.latitude) == pytest.approx(39.98)
    assert given.site.gravity == 9.80154
    assert given.table is not None and given.chamber is not None and given.sensor is not None
    assert [axis.name for axis in given.table.axes] == ["outer", "middle", "inner"]
    assert given.table.axes[0].direction == (0, 0, 1)
    assert given.table.axes[0].continuous
    assert math.degrees(given.table.position_uncertainty) * 3600 == pytest.approx(3)
    assert given.chamber.lowest == pytest.approx(218.15)
    assert given.chamber.ramp == pytest.approx(0.05)
    assert given.sensor.kind == "flexure-gyro"
    torquer = given.sensor.output("torquer_x")
    assert torquer is not None and torquer.unit == "pulse/s"
    assert not given.replays
    # 0.2012 deg/h is 0.2012·π/180/3600 rad/s.
    assert given.sensor.nominal["SF_X"] == pytest.approx(0.2012 * 4.848136811095e-6, rel=1e-12)
    assert given.sensor.nominal["D_X_X"] == pytest.approx(3.21 * 4.848136811095e-6 / 9.80665, rel=1e-12)


def test_a_bench_that_plays_back_has_no_table_and_says_so():
    given = models(read_bench("rimu_rate_staircase")[0])
    assert given.table is None
    assert given.chamber is None
    assert given.replays
    assert given.sensor is not None
    assert [output.name for output in given.sensor.outputs][:2] == ["lsm_gyro_x", "lsm_gyro_y"]
    # One sample scatters by 5 deg/s at 100 Hz, so the mean over 1 s by 0.5 deg/s.
    gyro = given.sensor.output("lsm_gyro_y")
    assert gyro is not None and gyro.noise.standard_error(1.0, 100.0) == pytest.approx(0.5)


def test_a_file_is_found_beside_the_plan(tmp_path):
    (tmp_path / "mine.yaml").write_text(HEAD + "instruments:" + TABLE, encoding="utf-8")
    bench, raw, shown = read_bench("mine.yaml", tmp_path)
    assert bench.name == "test"
    assert raw.startswith(b"planrunner_bench")
    assert shown == str(tmp_path / "mine.yaml")
    assert locate(str(tmp_path / "x.yaml"), Path("/elsewhere"))[0] == tmp_path / "x.yaml"


def test_unknown_benches_are_named_with_the_closest():
    with pytest.raises(InputError) as caught:
        read_bench("virtal")
    assert caught.value.findings[0].code == "meaning-unknown-bench"
    assert "did you mean 'virtual'" in caught.value.findings[0].hint
    with pytest.raises(InputError) as caught:
        read_bench("nowhere.yaml", Path("/nonexistent"))
    assert caught.value.findings[0].code == "file-missing"


def test_every_finding_comes_in_one_run(tmp_path):
    text = (
        "planrunner_bench: 1\nname: x\nclock: sundial\nsite: {latitude: 40 m, gravity: 9.8 m/s^2}\n"
        "instruments:\n  table: {driver: virtual_tabel}\n"
    )
    (tmp_path / "b.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_bench("b.yaml", tmp_path)
    seen = {item.code: (item.mark.line, item.mark.column) for item in caught.value.findings}
    assert seen == {"form-choice": (3, 8), "meaning-dimension": (4, 18), "form-unknown-driver": (6, 19)}


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        (
            HEAD + "instruments:" + TABLE + TABLE.replace("table:", "other:"),
            "meaning-role",
            "second table, in addition to 'table'",
        ),
        (
            HEAD + "instruments:" + CARRIER + CARRIER.replace("ship:", "other:"),
            "meaning-role",
            "second carrier, in addition to 'ship'",
        ),
        (
            HEAD + "safe_order: [chamber]\ninstruments:" + TABLE + CHAMBER,
            "meaning-safe-order",
            "'table' is never made safe",
        ),
        (HEAD + "safe_order: [table, tabel]\ninstruments:" + TABLE, "meaning-safe-order", "did you mean 'table'"),
        (HEAD + "safe_order: [table, table]\ninstruments:" + TABLE, "meaning-safe-order", "named twice"),
        (
            HEAD.replace("40 deg", "91 deg") + "instruments:" + TABLE,
            "meaning-range",
            "91 deg is not a possible latitude",
        ),
        (HEAD + "instruments:" + TABLE.replace("up,", "nroth,"), "form-choice", "did you mean 'north'"),
        (HEAD + "instruments:" + TABLE.replace("100 deg/s", "100 deg"), "meaning-dimension", "angular rate is needed"),
        (HEAD + "instruments:" + TABLE.replace("axes", "axis"), "form-unknown-key", "did you mean 'axes'"),
        ("planrunner: 1\ntitle: a plan\n", "form-plan", "this is a plan"),
    ],
)
def test_what_is_wrong_is_said(text, code, words):
    assert code in codes(text)
    assert words in findings(text)


@pytest.mark.parametrize(
    ("axes", "code"),
    [
        ("[{name: a, direction: up, @}, {name: b, direction: down, @}]", "meaning-table-axes"),
        (
            "[{name: a, direction: up, @}, {name: b, direction: east, @}, {name: c, direction: up, @}, {name: d, direction: east, @}]",
            "meaning-table-axes",
        ),
        ("[{name: a, direction: up, lowest: 10 deg, highest: -10 deg, @}]", "meaning-axis-limits"),
        ("[{name: a, direction: up, lowest: 10 deg, highest: 20 deg, @}]", "meaning-axis-limits"),
        ("[]", "form-size"),
    ],
)
def test_impossible_tables_are_findings(axes, code):
    axes = axes.replace("@", "max_rate: 1 deg/s, max_acceleration: 1 deg/s^2")
    assert codes(HEAD + "instruments: {table: {driver: virtual_table, axes: " + axes + "}}\n") == [code]


def test_a_channel_of_another_dimension_than_its_noise_is_a_finding():
    text = HEAD + (
        "instruments:\n  imu:\n    driver: recording\n    file: a.csv\n    kind: imu\n    time: {column: t}\n"
        "    sample_rate: 100 Hz\n    channels: {x: {column: c, unit: deg/s, noise: 1 g, sign: 0}}\n"
    )
    assert codes(text) == ["meaning-range", "meaning-dimension"]


def test_the_order_of_making_safe():
    text = HEAD + "instruments:" + CHAMBER + TABLE
    bench, _ = parse_bench(source.parse(text, "b.yaml"))
    assert bench is not None and safe_order(bench) == ("table", "chamber")
    stated, _ = parse_bench(
        source.parse(text.replace("instruments", "safe_order: [chamber, table]\ninstruments"), "b.yaml")
    )
    assert stated is not None and safe_order(stated) == ("chamber", "table")


SLIP = (st.sampled_from(sorted(shipped_benches())), st.integers(0, 10**9), st.text(max_size=6), st.integers(0, 30))


@settings(max_examples=60, deadline=None)
@given(*SLIP)
def test_a_bench_with_a_slip_of_the_pen_gives_findings_never_a_traceback(name, place, typed, deleted):
    slip(name, place, typed, deleted)


@pytest.mark.slow
@settings(max_examples=1000, deadline=None)
@given(*SLIP)
def test_slips_of_the_pen_at_length(name, place, typed, deleted):
    slip(name, place, typed, deleted)


def slip(name, place, typed, deleted):
    text = shipped_benches()[name].read_text(encoding="utf-8")
    at = place % len(text)
    try:
        root = source.parse(text[:at] + typed + text[at + deleted :], "b.yaml")
    except InputError as error:
        findings = error.findings
        root = None
    if root is None:
        assert findings
        return
    bench, log = parse_bench(root)
    assert log.errors or (bench is not None and models(bench).site.gravity > 0)


def test_the_shipped_folders_are_found():
    assert (shipped("plans") / "benches" / "virtual.yaml").is_file()
    with pytest.raises(FileNotFoundError, match="install it again"):
        shipped("no-such-folder")


def test_an_instrument_that_cannot_be_read_is_not_also_missing_from_the_safe_order():
    broken = TABLE.replace("max_rate: 100 deg/s", "max_rate: 0 deg/s")
    assert codes(f"{HEAD}safe_order: [table, chamber]\ninstruments:{broken}{CHAMBER}") == ["meaning-range"]


def test_two_axes_of_one_name_are_refused():
    second = "{name: outer, direction: east, max_rate: 100 deg/s, max_acceleration: 50 deg/s^2}"
    twice = TABLE.replace("^2}]", f"^2}}, {second}]")
    assert "two axes are called 'outer'" in findings(f"{HEAD}instruments:{twice}")
    assert codes(f"{HEAD}instruments:{twice}") == ["meaning-table-axes"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("lowest: -40 degC", "lowest: 70 degC", "the chamber's lowest temperature is not below its highest"),
        ("lowest: -40 degC", "lowest: -300 degC", "-300 degC is below absolute zero"),
    ],
)
def test_a_chamber_reaches_a_range_above_absolute_zero(old, new, said):
    text = f"{HEAD}instruments:{CHAMBER.replace(old, new)}"
    assert codes(text) == ["meaning-range"]
    assert f"b.yaml:6:46: error[meaning-range]: {said}" in findings(text)


def test_the_bounds_of_a_seed_are_whole_numbers():
    assert f"from 0 to {2**63 - 1}" in findings(f"{HEAD}seed: -1\ninstruments:{CHAMBER}")
