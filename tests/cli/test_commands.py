"""The commands as a user meets them: output, exit codes, and never a traceback."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from planrunner.cli import _start_no_threads
from planrunner.plan.quantity import parse_quantity
from tests import in_process

ROOT = Path(__file__).resolve().parents[2]
FLAGSHIP = ROOT / "plans" / "flexure_gyro_eight_position.yaml"
GIVEN = ("--set", "device_serial=FG-7", "--set", "operator=test")

Run = subprocess.CompletedProcess[str]


def planrunner(*arguments: object, cwd: Path, **environment: str) -> Run:
    done = in_process.planrunner(*arguments, cwd=cwd, **environment)
    assert "Traceback" not in done.stderr + done.stdout
    return done


def only_run(folder: Path) -> Path:
    (run,) = [path for path in (folder / "runs").iterdir() if not path.name.startswith(".")]
    return run


def test_the_folder_of_nights_beside_the_runs_is_skipped(finished: tuple[Path, Run], tmp_path: Path) -> None:
    """A pattern such as `runs/*` contains it. A folder of this name that is named alone is an error as before."""
    nights = tmp_path / "nights"
    nights.mkdir()
    run = only_run(finished[0])
    done = planrunner("export", run, nights, cwd=tmp_path)
    assert done.returncode == 0 and f"note: {nights} is skipped" in done.stderr
    assert done.stdout == planrunner("export", run, cwd=tmp_path).stdout
    assert planrunner("compare", run, run, nights, cwd=tmp_path).returncode == 0
    alone = planrunner("verify", nights, cwd=tmp_path)
    assert alone.returncode == 2 and "skipped" not in alone.stderr


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Run]:
    """One run of the flagship plan, shared by the tests that only read it."""
    folder = tmp_path_factory.mktemp("finished")
    done = planrunner("run", FLAGSHIP, *GIVEN, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder, done


def test_run_prints_the_coefficients_and_ends_with_the_report(finished: tuple[Path, Run]) -> None:
    folder, done = finished
    for word in ("SF_X", "epsilon", "D_Y_Z", "deg/h/g", "traditional", "ratio"):
        assert word in done.stdout
    report = folder / done.stdout.strip().splitlines()[-1]
    assert report.name == "report.html"
    assert "<svg" in report.read_text(encoding="utf-8")


def test_the_coefficients_are_those_of_the_simulated_gyro(finished: tuple[Path, Run]) -> None:
    """Truth as declared in plans/benches/virtual.yaml; four standard deviations, because fourteen numbers are compared."""
    folder, _ = finished
    results = json.loads((only_run(folder) / "analyses" / "1" / "results.json").read_text(encoding="utf-8"))
    truth = {
        "SF_X": 0.2012, "SF_Y": 0.1987, "epsilon": 8, "xi": -5, "D_X_F": 1.83, "D_X_X": 3.21, "D_X_Y": -2.14, "D_X_Z": 0.352,
        "D_Y_F": -1.27, "D_Y_X": 2.36, "D_Y_Y": 3.05, "D_Y_Z": -0.284,
    }  # fmt: skip
    found = {item["name"]: item for item in results["estimates"][0]["coefficients"]}
    for name, value in truth.items():
        assert abs(found[name]["value"] - value) < 4 * found[name]["standard_uncertainty"], name


def test_estimate_reproduces_the_numbers_exactly(finished: tuple[Path, Run]) -> None:
    folder, _ = finished
    run = only_run(folder)
    before = (run / "analyses" / "1" / "results.json").read_bytes()
    again = planrunner("estimate", run, cwd=folder)
    assert again.returncode == 0
    newest = max((run / "analyses").iterdir(), key=lambda path: int(path.name))
    assert int(newest.name) >= 2
    assert (newest / "results.json").read_bytes() == before
    assert "the same numbers as" in again.stderr


def test_export_report_and_show(finished: tuple[Path, Run]) -> None:
    folder, _ = finished
    run = only_run(folder)
    csv = planrunner("export", run, "drift", "--format", "csv", cwd=folder)
    assert csv.returncode == 0
    assert "SF_X" in csv.stdout
    header = planrunner("export", run, "traditional", "--format", "c", "--output", "gyro.h", cwd=folder)
    assert header.returncode == 0
    assert "#define" in (folder / "gyro.h").read_text() or "static const" in (folder / "gyro.h").read_text()
    wrong = planrunner("export", run, "drfit", cwd=folder)
    assert wrong.returncode == 2
    assert "did you mean 'drift'?" in wrong.stderr
    page = planrunner("show", FLAGSHIP, "--html", "show.html", cwd=folder)
    assert page.returncode == 0
    assert (folder / "show.html").read_text(encoding="utf-8").count("<svg") > 10
    table = planrunner("show", FLAGSHIP, cwd=folder)
    assert table.returncode == 0
    assert "P8" in table.stdout
    own = folder / "mine.md.j2"
    own.write_text("# {{ title }}\n", encoding="utf-8")
    through = planrunner("report", run, "--template", own, "--output", "mine.md", cwd=folder)
    assert through.returncode == 0, through.stderr
    assert "Optimal eight-position" in (folder / "mine.md").read_text(encoding="utf-8")
    own.write_text("{{ ''.__class__.__mro__ }}", encoding="utf-8")
    assert planrunner("report", run, "--template", own, cwd=folder).returncode == 2


def test_check_prints_findings_and_json(tmp_path: Path) -> None:
    good = planrunner("check", FLAGSHIP, cwd=tmp_path)
    assert good.returncode == 0
    assert "condition 2.61" in good.stdout
    bad = tmp_path / "bad.yaml"
    bad.write_text(
        FLAGSHIP.read_text(encoding="utf-8").replace("y: north, z: west}", "y: west, z: north}", 1), encoding="utf-8"
    )
    refused = planrunner("check", bad, "--json", cwd=tmp_path)
    assert refused.returncode == 2
    (finding,) = json.loads(refused.stdout)
    assert set(finding) == {"file", "line", "column", "code", "severity", "message", "hint"}
    assert finding["code"] == "meaning-left-handed"
    run = planrunner("run", bad, *GIVEN, cwd=tmp_path)
    assert run.returncode == 2
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("form", [[], ["--json"]])
def test_plans_that_processes_share_are_checked_as_by_one(tmp_path: Path, form: list[str]) -> None:
    text, plans = FLAGSHIP.read_text(encoding="utf-8"), []
    for number, (old, new) in enumerate([("2 min", "90 s"), ("segments: P*", "segments: Q*"), ("25 degC", "30 degC")]):
        plans.append(tmp_path / f"{number}.yaml")
        plans[-1].write_text(text.replace(old, new), encoding="utf-8")
    arguments = ["check", *map(str, plans), str(tmp_path / "absent.yaml"), str(FLAGSHIP), *form]
    alone = planrunner(*arguments, "--jobs", "1", cwd=tmp_path)
    command = [sys.executable, "-m", "planrunner", *arguments, "--jobs", "3"]
    shared = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (shared.returncode, shared.stdout, shared.stderr) == (2, alone.stdout, alone.stderr)
    assert "absent.yaml" in alone.stdout + alone.stderr and "meaning-undefined-label" in alone.stdout + alone.stderr


@pytest.mark.parametrize("jobs", ["0", "two"])
def test_an_impossible_number_of_jobs_is_refused(jobs: str, tmp_path: Path) -> None:
    done = planrunner("check", FLAGSHIP, "--jobs", jobs, cwd=tmp_path)
    assert done.returncode == 2
    assert "--jobs" in done.stderr


def test_a_failed_limit_decides_the_exit_code(tmp_path: Path) -> None:
    plan = tmp_path / "strict.yaml"
    plan.write_text(
        FLAGSHIP.read_text(encoding="utf-8").replace("within: ±5 deg/h", "within: ±0.5 deg/h", 1), encoding="utf-8"
    )
    done = planrunner("run", plan, *GIVEN, "--quiet", cwd=tmp_path)
    assert done.returncode == 1
    assert "report.html" in done.stdout.strip().splitlines()[-1]


def test_run_information_is_asked_for(tmp_path: Path) -> None:
    missing = planrunner("run", FLAGSHIP, cwd=tmp_path)
    assert missing.returncode == 2
    assert "requires 'device_serial'" in missing.stderr
    assert "requires 'operator'" in missing.stderr
    unknown = planrunner("run", FLAGSHIP, *GIVEN, "--set", "operater=x", cwd=tmp_path)
    assert unknown.returncode == 2
    assert "did you mean 'operator'?" in unknown.stderr
    info = tmp_path / "info.yaml"
    info.write_text("device_serial: FG-8\noperator: file\nambient_pressure: 101.2 kPa\n", encoding="utf-8")
    done = planrunner("run", FLAGSHIP, "--info", info, "--set", "work_order=W-1", "--quiet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    recorded = json.loads((only_run(tmp_path) / "run.json").read_text(encoding="utf-8"))["info"]
    assert recorded["device_serial"] == "FG-8"
    assert recorded["work_order"] == "W-1"
    assert recorded["ambient_pressure"] == "101.2 kPa"


def test_new_lists_and_copies(tmp_path: Path) -> None:
    listed = planrunner("new", cwd=tmp_path)
    assert "flexure_gyro_eight_position" in listed.stdout
    copied = planrunner("new", "flexure_gyro_eight_position", "mine.yaml", cwd=tmp_path)
    assert copied.returncode == 0
    assert planrunner("check", "mine.yaml", cwd=tmp_path).returncode == 0
    again = planrunner("new", "flexure_gyro_eight_position", "mine.yaml", cwd=tmp_path)
    assert again.returncode == 2
    assert planrunner("new", "flexure", cwd=tmp_path).returncode == 2


def test_self_test_and_bench_list(tmp_path: Path) -> None:
    done = planrunner("self-test", cwd=tmp_path)
    assert done.returncode == 0
    assert "17 of 17 comparisons passed" in done.stdout
    listed = planrunner("bench", "list", cwd=tmp_path)
    assert listed.returncode == 0
    assert "virtual_flexure_gyro" in listed.stdout


def test_tampering_is_an_integrity_error(tmp_path: Path) -> None:
    assert planrunner("run", FLAGSHIP, *GIVEN, "--quiet", cwd=tmp_path).returncode == 0
    run = only_run(tmp_path)
    file = next((run / "segments").glob("*P3*.parquet"))
    data = bytearray(file.read_bytes())
    data[200] ^= 1
    file.write_bytes(bytes(data))
    done = planrunner("estimate", run, cwd=tmp_path)
    assert done.returncode == 4
    assert "P3" in done.stderr


def test_whatever_is_no_run_folder(tmp_path: Path) -> None:
    for command in ("estimate", "resume", "report", "export"):
        done = planrunner(command, tmp_path, cwd=tmp_path)
        assert done.returncode == 2, command
        assert "not a run folder" in done.stderr


def test_unwritable_runs(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file stands here", encoding="utf-8")
    done = planrunner("run", FLAGSHIP, *GIVEN, cwd=tmp_path)
    assert done.returncode == 2
    assert "runs" in done.stderr


@pytest.mark.parametrize(
    "arguments", [[], ["frobnicate"], ["check"], ["run"], ["--help"], ["--version"], ["check", "--help"]]
)
def test_usage_without_tracebacks(tmp_path: Path, arguments: list[str]) -> None:
    done = planrunner(*arguments, cwd=tmp_path)
    assert done.returncode == (0 if arguments and arguments[-1].startswith("--") else 2)


def bad_files(folder: Path) -> dict[str, Callable[[Path], object]]:
    return {
        "empty.yaml": lambda path: path.write_bytes(b""),
        "binary.yaml": lambda path: path.write_bytes(bytes(range(256)) * 4),
        "folder.yaml": lambda path: path.mkdir(),
        "large.yaml": lambda path: path.write_bytes(b"# " + b"x" * 10_000_000),
        "deep.yaml": lambda path: path.write_bytes(b"planrunner: " + b"[" * 10_000 + b"]" * 10_000),
        "bomb.yaml": lambda path: path.write_text(
            "a: &a [x, x, x, x, x, x, x, x, x]\n"
            + "".join(f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))
        ),
        "tabs.yaml": lambda path: path.write_text("planrunner: 1\nsensor:\n\tkind: x\n"),
    }


@pytest.mark.parametrize("name", sorted(bad_files(Path())))
def test_bad_files(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    bad_files(tmp_path)[name](path)
    done = planrunner("check", path, cwd=tmp_path)
    assert done.returncode == 2
    assert f"{path}:" in done.stderr
    assert "error[" in done.stderr


def test_bom_and_crlf_are_welcome(tmp_path: Path) -> None:
    path = tmp_path / "windows.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + FLAGSHIP.read_bytes().replace(b"\n", b"\r\n"))
    assert planrunner("check", path, cwd=tmp_path).returncode == 0


def test_pure_numbers_are_printed_without_a_unit(tmp_path: Path) -> None:
    shown = planrunner("check", ROOT / "plans" / "imu_multi_position.yaml", cwd=tmp_path).stdout
    assert "gyro_scale_x" in shown
    assert not re.search(r"e-05 1\s", shown)
    assert str(parse_quantity("0.99", None)) == "0.99"
    assert str(parse_quantity("0.99 ± 0.01", None)) == "0.99 ± 0.01"


def test_a_seed_that_is_no_number_is_said_to_be_none(tmp_path: Path) -> None:
    wrong = planrunner("run", FLAGSHIP, "--seed", "abc", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "the seed must be a whole number: 'abc'" in wrong.stderr


def test_there_is_nothing_to_export_where_nothing_was_estimated(tmp_path: Path) -> None:
    text = FLAGSHIP.read_text(encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(
        text[: text.index("estimates:")].replace("dwell: 2 min", "dwell: 1 s"), encoding="utf-8"
    )
    assert planrunner("run", "plan.yaml", *GIVEN, cwd=tmp_path).returncode == 0
    assert planrunner("estimate", only_run(tmp_path), cwd=tmp_path).returncode == 0
    nothing = planrunner("export", only_run(tmp_path), cwd=tmp_path)
    assert nothing.returncode == 2
    assert "error[estimate-missing]: no estimate of this analysis has a result" in nothing.stderr


@pytest.mark.parametrize(
    ("command", "stated", "loaded", "threads"),
    [
        ("check", None, False, "1"),
        ("check", "3", False, "3"),  # as the user asks
        ("check", None, True, None),  # another program has imported numpy, whose threads are its own
        ("run", None, False, None),
    ],
)
def test_a_short_command_starts_no_threads_for_matrices(
    command: str, stated: str | None, loaded: bool, threads: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("JE_ARROW_MALLOC_CONF", "as before")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", stated or "")
    if stated is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    if not loaded:
        monkeypatch.delitem(sys.modules, "numpy")
    _start_no_threads(command)
    assert os.environ.get("OPENBLAS_NUM_THREADS") == threads


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forks on Linux only")
def test_processes_of_an_estimate_are_forks() -> None:
    """Neither numpy nor pyarrow, which read a recording, start threads in which a fork would not be safe."""
    program = (
        "from planrunner.cli import _start_no_threads; _start_no_threads('estimate')\n"
        "import numpy, pyarrow.parquet\n"
        "numpy.ones((200, 200)) @ numpy.ones((200, 200)); pyarrow.array([1.0])\n"
        "from planrunner.base.processes import _may_fork; print(_may_fork())"
    )
    plain = {
        name: text for name, text in os.environ.items() if name not in ("OPENBLAS_NUM_THREADS", "JE_ARROW_MALLOC_CONF")
    }
    said = subprocess.run([sys.executable, "-c", program], env=plain, capture_output=True, text=True, check=True)
    assert said.stdout == "True\n"
