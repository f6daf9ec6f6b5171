"""Certificates from plan to page: what `check` finds missing, what stands against issuing one, and that all of it comes at once."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import pytest

from planrunner.archive import formats
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.base.findings import InputError
from planrunner.cli import main
from planrunner.execution.stopping import StopRequest
from planrunner.reporting.certificate_requirements import ASKED
from planrunner.tasks.certify import ISSUED
from planrunner.tasks.check import check_plan
from planrunner.tasks.estimate import Analysis, Issue, analyse_run, report_through
from planrunner.tasks.run import start
from tests.conftest import FLAGSHIP, ROOT

Write = Callable[..., Path]

PAGE = ("certificate.html",)
GIVEN = {
    "certificate_number": "2026-0117",
    "customer": "The customer",
    "customer_contact": "2 Example Street",
    "item_description": "Flexure gyro",
    "date_received": "2026-02-27",
    "issued_by": "A. B., head of laboratory",
}
SHORT = (("dwell: 2 min", "dwell: 5 s"),)
RECORD = "record: {device_serial: required,"
ALL = RECORD + "".join(f" {name}: required," for name in GIVEN)
VIRTUAL = ROOT / "plans" / "benches" / "virtual.yaml"


def own_bench(folder: Path, *replacements: tuple[str, str]) -> Path:
    """The virtual bench with texts replaced, beside the plan."""
    text = VIRTUAL.read_text(encoding="utf-8")
    for old, new in replacements:
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "own.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def missing(path: Path, bench: Path | None = None) -> list[str]:
    checked = check_plan(path, bench=bench)
    return [str(item) for item in checked.findings.errors if item.code == "report-certificate-missing"]


# -- before a run ----------------------------------------------------------------------------------------------------------


def test_check_names_every_missing_element_at_the_report(plan_file: Write) -> None:
    path = plan_file(("report: [summary.md]", "report: [report.html, certificate.zh.html, certificate.html]"))
    found = missing(path)
    required = [item for item in ASKED if item.required and item.name != "device_serial"]
    assert len(found) == len(required) == 6
    line = next(
        n for n, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if text.startswith("report:")
    )
    for item in required:
        (one,) = [text for text in found if f"'{item.name}'" in text]
        assert one.startswith(f"{path}:{line}:23:")
        assert f"ISO/IEC 17025:2017, {item.clause})" in one


def test_an_unknown_certificate_is_only_called_unknown(plan_file: Write) -> None:
    path = plan_file(("report: [summary.md]", "report: [certificate.htm]"))
    assert [finding.code for finding in check_plan(path).findings.errors] == ["meaning-unknown-report"]


def test_a_plan_that_asks_for_everything_passes(plan_file: Write) -> None:
    assert missing(plan_file((RECORD, ALL), ("[summary.md]", "[certificate.html, certificate.zh.html]"))) == []
    assert missing(FLAGSHIP) == [], "a plan without a certificate is asked for nothing"


def test_optional_information_is_not_enough(plan_file: Write) -> None:
    optional = ALL.replace(" customer: required", " customer: optional")
    (one,) = missing(plan_file((RECORD, optional), ("[summary.md]", "[certificate.html]")))
    assert "'customer'" in one


def test_another_identification_serves_as_well(plan_file: Write) -> None:
    other = ALL.replace("device_serial", "item_identification")
    assert missing(plan_file((RECORD, other), ("[summary.md]", "[certificate.html]"))) == []


LABORATORY = VIRTUAL.read_text(encoding="utf-8").partition("laboratory:\n")[2].partition("\nsite:")[0]


def test_a_bench_without_laboratory_is_an_error(plan_file: Write, tmp_path: Path) -> None:
    path = plan_file((RECORD, ALL), ("[summary.md]", "[certificate.html]"))
    bench = own_bench(tmp_path, ("laboratory:\n" + LABORATORY + "\n", ""))
    assert any("7.8.2.1 b" in text for text in missing(path, bench))


def test_references_without_calibration_need_a_statement(plan_file: Write, tmp_path: Path) -> None:
    path = plan_file((RECORD, ALL), ("[summary.md]", "[certificate.html]"))
    text = VIRTUAL.read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if "calibration:" not in line and "traceability:" not in line]
    bench = tmp_path / "own.yaml"
    bench.write_text("\n".join(kept), encoding="utf-8")
    (one,) = missing(path, bench)
    assert "'table'" in one and "'chamber'" in one and "'gyro'" not in one and "7.8.4.1 c" in one


# -- issuing one -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run on the virtual bench, with one authorised signatory and the room's conditions."""
    folder = tmp_path_factory.mktemp("recorded")
    text = FLAGSHIP.read_text(encoding="utf-8")
    for old, new in SHORT:
        assert old in text
        text = text.replace(old, new)
    (folder / "plan.yaml").write_text(text.replace("bench: virtual", "bench: own.yaml"), encoding="utf-8")
    room = "ambient: {temperature: 23 degC}\nlaboratory:\n  authorised: [head of laboratory]\n"
    own_bench(folder, ("laboratory:\n", room))
    return started(folder)


def started(folder: Path) -> Path:
    sound = check_plan(folder / "plan.yaml").sound()
    info = {"device_serial": "FG-7", "operator": "test"}
    path, outcome = start(sound, info=info, runs=folder / "runs", stop=StopRequest(), durability="flushed")
    assert outcome.ok
    return path


@pytest.fixture(scope="module")
def earlier(recorded: Path) -> Path:
    """Another run of the same plan on the same item."""
    return started(recorded.parents[1])


@pytest.fixture
def run(recorded: Path, tmp_path: Path) -> Path:
    """A copy of it, without analyses."""
    return Path(shutil.copytree(recorded, tmp_path / recorded.name))


def refused(run: Path, given: dict[str, str], before: Path | None = None) -> list[str]:
    with pytest.raises(InputError) as caught:
        analyse_run(run, Issue(PAGE, given, before))
    return [finding.code.removeprefix("report-certificate-") for finding in caught.value.findings]


def page_of(analysis: Analysis) -> str:
    return analysis.reports[0].read_text(encoding="utf-8")


def test_it_is_issued_in_both_languages_as_a_new_analysis(run: Path) -> None:
    made = analyse_run(run, Issue(("certificate.html", "certificate.zh.html"), GIVEN))
    assert [path.name for path in made.reports] == ["certificate.html", "certificate.zh.html"]
    english, chinese = (path.read_text(encoding="utf-8") for path in made.reports)
    today = datetime.now(UTC).date().isoformat()
    for page in (english, chinese):
        for expected in ("2026-0117", "FG-7", "23 degC", today, run.name, "A. B., head of laboratory"):
            assert expected in page, expected
        assert 'class="lacking"' in page, "the condition of the item was not stated"
    assert "Simulated: not a calibration" in english
    assert "仿真结果：不构成校准" in chinese
    assert "漂移 D(X) 中与加速度无关的部分" in chinese
    reader = RunReader.open(run)
    assert reader.state.created["files"]["plan.yaml"] in english
    reader.check_digests()


def test_everything_that_is_missing_is_reported_at_once(run: Path) -> None:
    assert refused(run, {}) == ["missing"] * 6
    assert refused(run, {**GIVEN, "customer": ""}) == ["missing"]
    assert not (run / "analyses").exists()


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"date_received": "1 March"}, "date"),
        ({"date_received": "20260227"}, "date"),
        ({"date_received": "2999-01-01"}, "date"),
        ({"date_issued": "2020-01-01"}, "date"),
        ({"issued_by": "A. B., operator"}, "authority"),
        ({"certified_estimates": "drfit"}, "estimates"),
        ({"external_provider": "Another laboratory"}, "estimates"),
        ({"amends": "2026-0099"}, "amendment"),
        ({"amends": "2026-0117", "amendment_reason": "x"}, "amendment"),
    ],
)
def test_what_contradicts_itself_is_refused(run: Path, given: dict[str, str], code: str) -> None:
    assert refused(run, {**GIVEN, **given}) == [code]


def test_a_second_certificate_is_an_amendment(run: Path) -> None:
    analyse_run(run, Issue(PAGE, GIVEN))
    assert refused(run, GIVEN) == ["amendment"]
    amended = {**GIVEN, "certificate_number": "2026-0118", "amends": "2026-0117", "amendment_reason": "customer's name"}
    again = analyse_run(run, Issue(PAGE, amended))
    kept = formats.parse_json(
        (again.folder / ISSUED).read_bytes(), again.folder / ISSUED, "issued", "planrunner_issued", 1
    )
    assert (kept["certificate_number"], kept["amends"]) == ("2026-0118", "2026-0117")
    page = page_of(again)
    assert "Amendment to calibration certificate 2026-0117, which this certificate replaces" in page
    assert "customer&#39;s name" in page
    third = {**amended, "certificate_number": "2026-0119", "amends": "2026-0011"}
    assert refused(run, third) == ["amendment"], "a number that was never issued"
    assert refused(run, {**amended, "amends": "2026-0118", "certificate_number": "2026-0117"}) == ["amendment"]
    assert analyse_run(run, Issue(PAGE, {**third, "amends": "2026-0118"})).reports


def test_what_was_never_issued_cannot_be_amended(run: Path) -> None:
    amended = {**GIVEN, "certificate_number": "2026-0118", "amends": "2026-0117", "amendment_reason": "x"}
    with pytest.raises(InputError, match="no certificate '2026-0117' has been issued for this run"):
        analyse_run(run, Issue(PAGE, amended))


def test_a_report_named_twice_is_written_once(run: Path) -> None:
    assert [path.name for path in analyse_run(run, Issue(("summary.md", "summary.md"))).reports] == ["summary.md"]


def test_a_run_does_not_come_before_its_own_adjustment(run: Path, recorded: Path) -> None:
    for itself in (run, recorded):  # a copy is the same run
        assert refused(run, GIVEN, itself) == ["before"]


def test_what_the_run_recorded_can_be_corrected_visibly(run: Path) -> None:
    page = page_of(analyse_run(run, Issue(PAGE, {**GIVEN, "device_serial": "FG-8"})))
    assert "FG-8" in page
    assert "Corrected after the run: device_serial, which was recorded as “FG-7”." in page


def test_results_of_the_run_before_the_adjustment(run: Path, earlier: Path, tmp_path: Path) -> None:
    page = page_of(analyse_run(run, Issue(PAGE, {**GIVEN, "adjustment": "gain trimmed"}, earlier)))
    assert "Before adjustment" in page and "gain trimmed" in page
    assert refused(run, {**GIVEN, "device_serial": "FG-8"}, earlier) == ["amendment", "before"]


def test_a_run_that_is_not_finished_has_no_certificate(run: Path) -> None:
    RunWriter.reopen(run, reason="a segment is to be taken again").close()
    assert refused(run, GIVEN) == ["incomplete"]


def test_the_plans_certificate_is_withheld_once_one_is_issued(plan_file: Write, tmp_path: Path) -> None:
    """A plan that asks for it gets it with the run; estimating again does not issue a second one."""
    path = plan_file((RECORD, ALL), *SHORT, ("report: [summary.md]", "report: [certificate.html, summary.md]"))
    info = {**GIVEN, "device_serial": "FG-7", "operator": "test"}
    folder, _ = start(
        check_plan(path).sound(), info=info, runs=tmp_path / "runs", stop=StopRequest(), durability="flushed"
    )
    first = analyse_run(folder)
    assert [report.name for report in first.reports] == ["certificate.html", "summary.md"]
    again = analyse_run(folder)
    assert [report.name for report in again.reports] == ["summary.md"]
    assert [finding.code for finding in again.withheld] == ["report-certificate-amendment"]


def test_a_template_of_ones_own_gets_the_same_facts(run: Path, tmp_path: Path) -> None:
    template = tmp_path / "ours.html.j2"
    template.write_text("{{ certificate.number }} {{ certificate.told.customer }} {{ certificate.laboratory.name }}")
    assert report_through(run, template, Issue(given=GIVEN)) == "2026-0117 The customer Virtual laboratory"


# -- the command -----------------------------------------------------------------------------------------------------------


def test_the_command_takes_a_file_and_settings(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = tmp_path / "issue.yaml"
    told.write_text("".join(f"{name}: {text}\n" for name, text in GIVEN.items()), encoding="utf-8")
    assert main(["report", str(run), "certificate.html", "--info", str(told), "--set", "item_condition=as new"]) == 0
    (path,) = capsys.readouterr().out.split()
    assert "as new" in Path(path).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["certificat.html"], "meaning-unknown-report"),
        (["certificate.html", "--set", "custommer=x"], "run-info-unknown"),
        (["certificate.html", "--set", "customer"], "run-info-value"),
        (["certificate.html"], "report-certificate-missing"),
        (["certificate.html", "--before", "nowhere"], "run-not-found"),
    ],
)
def test_the_command_says_what_is_wrong(
    run: Path, arguments: list[str], code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(run), *arguments]) == 2
    assert f"error[{code}]" in capsys.readouterr().err
