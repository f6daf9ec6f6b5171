"""`planrunner check SUITE`: the findings of all plans on all benches, what is missing, and the timetable as text, JSON and page."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planrunner.tasks.check_suite import check_suite, is_suite
from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "plans" / "suites" / "laboratory_night.yaml"
PLAN = """\
planrunner: 1
title: Two positions
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
record: {device_serial: required, note: optional}
defaults: {temperature: 25 degC, dwell: 10 min}
segments:
  - {label: A, orientation: {x: up, y: north}}
  - {label: B, orientation: {x: down, y: north}}
"""


def written(folder: Path, suite: str, **plans: str) -> Path:
    for name, text in plans.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    file = folder / "night.yaml"
    file.write_text("planrunner_suite: 1\ntitle: Night\n" + suite, encoding="utf-8")
    return file


def test_the_shipped_suite_is_sound_and_needs_half_a_night() -> None:
    checked = check_suite(SHIPPED, at="2026-10-24T19:00")
    assert [str(item) for item in checked.findings] == []
    assert checked.virtual and checked.forecast is not None
    # 30 min of warm-up, then three calibrations one after the other on each bench
    (drift,) = {checked.plans[test.measurement].seconds for test in checked.tests if test.entry == "drift"}
    assert drift is not None
    assert checked.forecast.ends - checked.forecast.hours.begins == pytest.approx(1800 + 3 * drift)


def test_a_suite_is_told_from_a_plan_by_its_key(tmp_path: Path) -> None:
    assert is_suite(SHIPPED)
    mentioned = PLAN.replace("Two positions", "A plan, not a planrunner_suite")
    suite = written(
        tmp_path, "benches: {a: {bench: virtual}}\nplans: {p: {plan: p.yaml, set: {device_serial: X}}}\n", p=mentioned
    )
    assert not is_suite(tmp_path / "p.yaml") and not is_suite(tmp_path / "none.yaml")
    both = planrunner("check", suite, tmp_path / "p.yaml", cwd=tmp_path)
    assert both.returncode == 0, both.stdout + both.stderr
    assert "1 of 1 test on 1 bench" in both.stdout and "2 segments on bench 'virtual'" in both.stdout
    run = planrunner("run", suite, cwd=tmp_path)
    assert run.returncode == 2 and "form-suite" in run.stderr


def test_the_findings_of_all_plans_on_all_benches_are_reported(tmp_path: Path) -> None:
    suite = """\
set: {opertor: night}
benches: {a: {bench: virtual}, m: {bench: virtual_mems}, x: {bench: none.yaml}}
plans:
  good: {plan: p.yaml, benches: a}
  wrong: {plan: wrong.yaml, benches: a, set: {device_serial: D, colour: red}}
  gone: {plan: gone.yaml, benches: a}
  other: {plan: p.yaml, benches: [m, x]}
"""
    wrong = PLAN.replace("down, y: north", "down, y: up")
    file = written(tmp_path, suite, p=PLAN, wrong=wrong)
    done = planrunner("check", file, "--json", cwd=tmp_path)
    assert done.returncode == 2
    found = {
        (Path(item["file"]).name, item["line"], item["code"])
        for item in json.loads(done.stdout)
        if item["severity"] == "error"
    }
    assert ("night.yaml", 6, "suite-information-missing") in found  # device_serial of good
    assert ("night.yaml", 8, "file-missing") in found
    assert ("night.yaml", 4, "file-missing") in found  # bench x
    assert any(name == "wrong.yaml" and line == 8 for name, line, _ in found)
    assert any(name == "p.yaml" and code == "meaning-sensor-kind" for name, _, code in found)


def test_unknown_and_unused_run_information(tmp_path: Path) -> None:
    suite = """\
set: {opertor: night}
benches: {a: {bench: virtual}}
plans: {good: {plan: p.yaml, set: {device_serial: D}, matrix: {fixtre: [a, b]}}}
"""
    found = {item.code: item for item in check_suite(written(tmp_path, suite, p=PLAN)).findings}
    assert found["run-info-unknown"].severity == "error" and "fixtre" in found["run-info-unknown"].message
    assert found["suite-information-unused"].severity == "warning"


def test_each_combination_of_parameters_is_checked_and_its_mistakes_are_at_its_values(tmp_path: Path) -> None:
    """The plan itself is correct. Of six combinations, those with a wrong unit fail at their value in the suite; a dwell of 0 s too."""
    suite = """\
set: {device_serial: D}
benches: {a: {bench: virtual}}
plans:
  good:
    plan: p.yaml
    parameters:
      dwell: [5 min, 5 kg, 20 min]
      second: [down, upwards]
  unknown: {plan: p.yaml, parameters: {dwel: 1 min}}
  single: {plan: p.yaml, parameters: {dwell: 0 s}}
  same: {plan: p.yaml, parameters: {second: up}}
"""
    varied = PLAN.replace("dwell: 10", "dwell: &dwell 10").replace("{x: down", "{x: &second down")
    file = written(tmp_path, suite, p=varied)
    done = planrunner("check", file, "--json", cwd=tmp_path)
    assert done.returncode == 2
    found = {
        (Path(item["file"]).name, item["line"], item["column"]): item["message"]
        for item in json.loads(done.stdout)
        if item["severity"] == "error"
    }
    assert set(found) == {("night.yaml", 9, 22), ("night.yaml", 10, 22), ("night.yaml", 11, 46), ("night.yaml", 12, 46)}
    assert (
        found["night.yaml", 9, 22].startswith("dwell = 5 kg: ") and "second = upwards: " in found["night.yaml", 10, 22]
    )
    assert "no parameter 'dwel'" in found["night.yaml", 11, 46] and found["night.yaml", 12, 46].startswith(
        "dwell = 0 s: "
    )
    sound = written(tmp_path, suite.replace(", 5 kg", "").replace(", upwards", "").partition("  unknown")[0])
    checked = check_suite(sound)
    assert checked.ok
    short, long = checked.durations
    assert short is not None and long is not None and long - short == pytest.approx(2 * 15 * 60)


@pytest.mark.parametrize(
    "entry",
    ["{when: failed}", "{webhook: 'https://a.example.org/', email: a@example.org, from: b@example.org}", "{email: a@example.org}",
     "{email: a@example.org, from: b@example.org, user: u}",
     "{email: a@example.org, from: b@example.org, user: u, password_from: P, security: none}"],
)  # fmt: skip
def test_a_notification_has_one_receiver_and_never_an_open_password(tmp_path: Path, entry: str) -> None:
    suite = f"benches: {{a: {{bench: virtual}}}}\nplans: {{p: {{plan: p.yaml, set: {{device_serial: D}}}}}}\nnotify: [{entry}]\n"
    codes = [item.code for item in check_suite(written(tmp_path, suite, p=PLAN)).findings]
    assert codes == ["suite-notification"]


def test_what_does_not_fit_is_a_warning_in_the_text_and_on_the_page(tmp_path: Path) -> None:
    suite = """\
zone: Europe/Berlin
window: {from: "22:00", to: "06:00"}
budget: 30 min
benches: {a: {bench: virtual, warm_up: 5 min}}
plans: {p: {plan: p.yaml, set: {device_serial: "<b>&"}, matrix: {note: ["1", "<i>2"]}}}
"""
    file = written(tmp_path, suite, p=PLAN)
    done = planrunner("check", file, "--at", "2026-10-24T23:00", "--html", tmp_path / "page.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "suite-does-not-fit" in done.stderr
    assert "1 of 2 tests on 1 bench, from 2026-10-24 23:00 CEST" in done.stdout
    assert "will not run: p/a/note=<i>2: it does not fit: it takes 20 min" in done.stdout
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "p/a/note=&lt;i&gt;2" in page and "<i>" not in page and "<svg" in page
    assert "://" not in page.replace("http://www.w3.org/2000/svg", "")


@pytest.mark.parametrize(
    "words",
    [("--html", "x.html", "p.yaml"), ("--at", "2026-10-24T23:00", "p.yaml"), ("--at", "tomorrow", "night.yaml"),
     ("--bench", "virtual", "night.yaml")],
)  # fmt: skip
def test_arguments_for_suites_need_one(tmp_path: Path, words: tuple[str, ...]) -> None:
    written(tmp_path, "benches: {a: {bench: virtual}}\nplans: {p: {plan: p.yaml, set: {device_serial: D}}}\n", p=PLAN)
    assert planrunner("check", *words, cwd=tmp_path).returncode == 2


def test_a_wrong_zone_and_a_file_that_is_no_yaml(tmp_path: Path) -> None:
    suite = "zone: Mars/Olympus\nbenches: {a: {bench: virtual}}\nplans: {p: {plan: p.yaml, set: {device_serial: D}}}\n"
    file = written(tmp_path, suite, p=PLAN)
    assert [item.code for item in check_suite(file).findings] == ["suite-zone"]
    file.write_text("planrunner_suite: [", encoding="utf-8")
    assert not check_suite(file).ok and check_suite(file).findings.errors
