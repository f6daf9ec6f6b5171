"""The attribution of several runs in sentences, tables, JSON and on its page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from planrunner.cli import main
from planrunner.cli.exit_codes import WRONG_INPUT
from planrunner.gap.fleet.amplitudes import AmplitudeKey
from planrunner.gap.fleet.attribution import Estimates, Source, attribute
from planrunner.reporting.fleet_page import limits, render_page, sentences, tables
from planrunner.tasks.diagnose_fleet import Attributed, FleetDiagnosis, RunOrigin, RunVerdict

SCHEMA = json.loads((Path(__file__).parents[2] / "schemas" / "fleet.schema.json").read_text(encoding="utf-8"))


def fleet(benches: str, devices: str, tilt: list[float], scale: list[float], u: float = 0.3) -> FleetDiagnosis:
    """Runs on benches and of devices with these letters; a tilt and a scale factor in each."""
    origins = tuple(
        RunOrigin(Path(f"runs/r{n}"), {Source.BENCH: f"B{b}", Source.DEVICE: f"<{d}>", Source.OCCASION: f"r{n}"})
        for n, (b, d) in enumerate(zip(benches, devices, strict=True))
    )
    verdict = RunVerdict("Plan", "imu", ("accel_scale_factor",), "effect", ("table_tilt",), (), {}, {}, "simulated")
    found = []
    for effect, name, unit, values in (
        ("table_tilt", "about_east", "arcsec", tilt),
        ("accel_scale_factor", "k_x", "ppm", scale),
    ):
        spreads = (u,) * len(values)
        groups = {source: [one.labels[source] for one in origins] for source in origins[0].labels}
        made = attribute(Estimates(np.array(values), np.array(spreads), groups))
        found.append(
            Attributed(AmplitudeKey(effect, name, unit), tuple(range(len(values))), tuple(values), spreads, made)
        )
    left = {"gyro_noise_excess": "it acts on the noise and has no amplitude"}
    return FleetDiagnosis(origins, (verdict,) * len(origins), ("table_tilt",), tuple(found), left)


@pytest.fixture(scope="module")
def crossed() -> dict:
    """Bench v is tilted by 60 arcsec; device c is off by 210 ppm."""
    tilt = [0.1, -0.2, 0.3, 60.1, 59.8, 60.2]
    scale = [0.2, -0.1, 210.3, 0.1, 0.2, 209.9]
    return dict(fleet("uuuvvv", "abcabc", tilt, scale).to_json())


def test_the_output_fits_the_schema(crossed: dict) -> None:
    Draft202012Validator.check_schema(SCHEMA)
    Draft202012Validator(SCHEMA).validate(json.loads(json.dumps(crossed, allow_nan=False)))


def test_bench_and_device_are_named_with_their_values(crossed: dict) -> None:
    said = sentences(crossed)
    tilted = next(text for text in said if text.startswith("bench Bv: table_tilt about_east 60.0"))
    assert "3 runs, 3 devices, P > 0.9" in tilted
    wrong = next(text for text in said if text.startswith("device <c>: accel_scale_factor k_x 210."))
    assert "from the mean of the others (2 runs, P > 0.9" in wrong
    assert not any("occasion" in text or "switch-on" in text for text in said)


def test_the_table_gives_the_shares(crossed: dict) -> None:
    rows = tables(crossed)["attribution"].rows
    assert [row[:3] for row in rows] == [("table_tilt", "about_east", "6"), ("accel_scale_factor", "k_x", "6")]
    assert rows[0][6:] and str(rows[0][-1]).startswith("bench (P > 0.9")
    assert str(rows[1][-1]).startswith("device (P > 0.9")


def test_one_bench_with_one_device_cannot_be_distinguished() -> None:
    found = dict(fleet("uuu", "aaa", [60.1, 59.8, 60.2], [0.1, 0.0, -0.1]).to_json())
    (limit, noise) = limits(found)
    assert limit.startswith("One device and one bench only: device, bench and what all runs have in common cannot be")
    assert "measure a second device" in limit and "measure on a second bench" in limit
    assert noise == "gyro_noise_excess is not attributed: it acts on the noise and has no amplitude."
    (said,) = sentences(found)
    assert said.startswith("device <a>, or bench Bu, or what all runs have in common: table_tilt about_east 60.0")
    assert str(tables(found)["attribution"].rows[0][3]).startswith("≤ ")


def test_devices_that_ran_once_may_change_at_each_switch_on() -> None:
    found = dict(fleet("uuuuu", "abcde", [0.0] * 5, [300.0, -150.0, 80.0, -310.0, 120.0]).to_json())
    assert any("One run for each device: device and occasion cannot be distinguished" in text for text in limits(found))
    said = next(text for text in sentences(found) if "accel_scale_factor k_x differs from run to run" in text)
    assert said.endswith("device and occasion cannot be distinguished.")


def test_the_page_is_stamped_and_escapes_labels(crossed: dict) -> None:
    page = render_page(crossed, ["a remark"], "simulated")
    assert "SIMULATED" in page and "a remark" in page
    assert "&lt;c&gt;" in page and "<c>" not in page


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a", "b", "--also", "c"], "--also cannot be given with several runs"),
        (["a", "--origins", "o.csv"], "--origins is for several runs"),
        (["a", "b", "a"], "this run is given twice"),
    ],
)
def test_what_does_not_fit_several_runs_is_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diagnose", *words]) == WRONG_INPUT
    assert said in capsys.readouterr().err
