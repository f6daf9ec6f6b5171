"""Signals that end a command, wherever it is: a line on standard error and exit code 130, never a traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from planrunner import cli
from planrunner.base.interruption import Interruption
from planrunner.cli import main

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as on POSIX")
ROOT = Path(__file__).resolve().parents[2]
SEND = "import os, signal\nos.kill(os.getpid(), signal.SIGNAL)\n"
IMPORTS = {
    "plain": SEND,
    "within exec, as where dataclasses are made": "import os, signal\nexec('os.kill(os.getpid(), signal.SIGNAL)')\n",
    "turned into another error": "try:\n    import os, signal\n    os.kill(os.getpid(), signal.SIGNAL)\n    [0 for _ in range(9)]\n"
    "except BaseException as error:\n    raise ImportError('yaml is broken') from error\n",
    "let go of": "import os, signal, time\nclass Released:\n    def __del__(self):\n        os.kill(os.getpid(), signal.SIGNAL)\n"
    "        [0 for _ in range(9)]\nReleased()\ntime.sleep(60)\n",
}
"""How a module behaves during whose import a signal comes."""


@pytest.mark.parametrize("how", IMPORTS)
@pytest.mark.parametrize(("name", "said"), [("SIGINT", "interrupted\n"), ("SIGTERM", "ended by SIGTERM\n")])
def test_while_modules_are_imported(tmp_path: Path, how: str, name: str, said: str) -> None:
    (tmp_path / "yaml.py").write_text(IMPORTS[how].replace("SIGNAL", name), encoding="utf-8")
    command = [sys.executable, "-m", "planrunner", "check", str(ROOT / "plans" / "flexure_gyro_eight_position.yaml")]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", said)


def test_while_the_interpreter_ends(tmp_path: Path) -> None:
    """The command's own exit code stands."""
    code = (
        "import atexit, os, signal, sys; from planrunner.__main__ import main; sys.argv[1:] = ['export', 'nowhere'];"
        "atexit.register(lambda: (os.kill(os.getpid(), signal.SIGTERM), [0 for _ in range(9)])); sys.exit(main())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 2 and "Traceback" not in run.stderr


def test_before_anything_is_imported(tmp_path: Path) -> None:
    """Not even the module that listens from then on."""
    (tmp_path / "threading.py").write_text(IMPORTS["plain"].replace("SIGNAL", "SIGINT"), encoding="utf-8")
    command = [sys.executable, "-c", "from planrunner.__main__ import main; main()"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert (run.returncode, run.stdout, run.stderr) == (130, "", "interrupted\n")


@pytest.mark.parametrize(("name", "said"), [("SIGINT", "interrupted\n"), ("SIGTERM", "ended by SIGTERM\n")])
def test_in_the_middle_of_a_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, said: str
) -> None:
    number = signal.Signals[name]
    before = signal.getsignal(number)

    def interrupted(*_: object) -> int:
        signal.raise_signal(number)
        return 0

    monkeypatch.setattr(cli, "_run", interrupted)
    assert main(["check", "x.yaml"]) == 130
    assert capsys.readouterr() == ("", said)
    assert signal.getsignal(number) == before


def test_what_a_library_makes_of_it_is_no_internal_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            raise SystemError("returned a result with an exception set") from error
        return 0

    monkeypatch.setattr(cli, "_run", interrupted)
    assert main(["check", "x.yaml"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_what_python_lets_go_of_is_raised_again() -> None:
    class Released:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    begun = time.monotonic()
    with Interruption() as interruption:
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012 - the first is lost within `del`
            released = Released()
            del released
            time.sleep(60)
        assert interruption.reason == "interrupted"
    assert time.monotonic() - begun < 30  # the wait itself was ended


def test_what_is_ignored_on_purpose_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interruption() as interruption:
            signal.raise_signal(signal.SIGHUP)
        assert interruption.reason == ""
    finally:
        signal.signal(signal.SIGHUP, before)


def test_in_another_thread_signals_are_left_alone() -> None:
    before, found = signal.getsignal(signal.SIGTERM), []

    def work() -> None:
        with Interruption():
            found.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [before]
