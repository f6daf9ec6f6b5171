"""Every benchmark runs at a small size, and its figures are kept with commit and date without losing those of others."""

from __future__ import annotations

import math
import runpy
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from benchmarks import __main__ as command
from benchmarks.measuring import ROOT, ProcessFailedError, counted, figures_of
from benchmarks.shipped_results import differences

MEASURES_WITH = {"__init__", "__main__", "measuring", "made_archive", "shipped_results"}
UNIX = {"sensor_streaming": "it needs pseudo-terminals"}


def test_every_module_is_named() -> None:
    assert {path.stem for path in (ROOT / "benchmarks").glob("*.py")} - MEASURES_WITH == set(command.NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("name", command.NAMES)
def test_it_runs_at_a_small_size(name: str) -> None:
    if name in UNIX and sys.platform == "win32":
        pytest.skip(UNIX[name])
    module = import_module(f"benchmarks.{name}")
    rows = module.run(module.SMALL)
    figures = [figure for figure in rows.values() if not isinstance(figure, str)]
    assert figures
    assert all(math.isfinite(figure) for figure in figures), rows
    assert not {what for what, figure in rows.items() if what.endswith(("/s]", "[s]", "[ms]")) and figure == 0}


def test_absent_peers_are_named_and_the_rest_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("openhtf", "bluesky", "ophyd", "ophyd.sim"):
        monkeypatch.setitem(sys.modules, name, None)
    from benchmarks import executor_steps

    rows = executor_steps.run(executor_steps.SMALL)
    assert "openhtf is not installed" in str(rows["OpenHTF [steps/s]"])
    assert "bluesky" in str(rows["bluesky [steps/s]"])
    figures = [figure for what, figure in rows.items() if what.startswith("flushed")]
    assert figures and all(isinstance(figure, float) and figure > 0 for figure in figures)


def test_every_kept_figure_belongs_to_a_benchmark() -> None:
    text = command.README.read_text(encoding="utf-8")
    assert set(command.sections(text)) == set(command.kept_figures(text)) <= set(command.NAMES)


def figures(name: str) -> dict[str, object]:
    if name == "allan":
        raise ArithmeticError("too large")
    return {"ratio": 2.0, "note": "x"}


def test_one_that_fails_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    readme = tmp_path / "README.md"
    old = "`python -m benchmarks {0}` took {1} s."
    kept = "\n\n".join(f"### {name}\n\n{old.format(name, 7)}" for name in ("check_speed", "allan", "monte_carlo"))
    readme.write_text(f"before\n{command.START}\n{kept}\n\n{command.END}\nafter\n", encoding="utf-8")

    def here(function: object, name: str) -> dict[str, object]:
        try:
            return figures(name)
        except ArithmeticError as error:
            raise ProcessFailedError(str(error)) from None

    monkeypatch.setattr(command, "figures_of", here)
    monkeypatch.setattr(command, "commit", lambda: "abc123-dirty")
    assert command.run(["check_speed", "allan", "monte_carlo", "diagnosis"], readme) == 1
    assert "no new figures of allan: too large" in capsys.readouterr().err
    text = readme.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("after\n")
    found = command.kept_figures(text)
    assert list(found) == ["check_speed", "allan", "monte_carlo", "diagnosis"]
    assert found["allan"] == command.Kept(7, "", "")
    assert found["diagnosis"].commit == found["check_speed"].commit == "abc123-dirty"
    assert len(found["diagnosis"].date) == 10
    assert "run it again" in command.listed(["allan"], found)


def test_as_a_command_it_measures_in_a_process_that_can_import_what_it_calls(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    started: list[list[str]] = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        started.append(command)
        return subprocess.CompletedProcess(command, 0, '{"ratio": 2.0}', "")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(command, "commit", lambda: "abc123")
    monkeypatch.setattr(sys, "argv", ["benchmarks", "allan"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / "benchmarks" / "__main__.py"), run_name="__main__")
    assert ended.value.code == 0, capsys.readouterr().err
    (module, name) = next(words[3:5] for words in started if "benchmarks.measuring" in words)
    assert callable(getattr(import_module(module), name))
    assert "2" in capsys.readouterr().out


def test_a_process_that_fails_says_why() -> None:
    here = {"PYTHONPATH": str(Path(__file__).parent)}
    with pytest.raises(ProcessFailedError, match=r"refused.*exit code 1: .*ZeroDivisionError"):
        figures_of(refused, 0, environment=here)
    assert figures_of(refused, 4, environment=here) == {"ratio": 0.25}


def refused(number: float) -> dict[str, float]:
    return {"ratio": 1 / number}


@pytest.mark.parametrize(
    ("number", "words"),
    [(400, "400"), (10**8, "10⁸"), (4_000_000, "4·10⁶"), (51_840_000, "5.184·10⁷"), (1.44e6, "1.44·10⁶")],
)
def test_counts_in_words(number: float, words: str) -> None:
    assert counted(number) == words


def test_a_result_that_moved_is_found() -> None:
    kept = {"plan": {"run": {"printed": {"estimates": [{"value": 2.0, "unit": "1"}], "analysis": "one"}}}}
    same = {"plan": {"run": {"printed": {"estimates": [{"value": 2.0 + 1e-9, "unit": "1"}], "analysis": "two"}}}}
    moved = {"plan": {"run": {"printed": {"estimates": [{"value": 2.0 + 1e-8, "unit": "1"}], "analysis": "one"}}}}
    assert list(differences(kept, same)) == []
    assert len(list(differences(kept, moved))) == 1
