"""The simulated bench as a process: what it says on its addresses, what it is told, and how it ends."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from planrunner.bench.model import read_bench
from planrunner.bench.opening import open_bench
from planrunner.bench.simulation import SimulationSpec, ask, attach
from planrunner.cli import main
from planrunner.cli.exit_codes import FAULT, WRONG_INPUT
from planrunner.instruments.interfaces import Hastens, InstrumentError
from planrunner.simulators.ports import Address, PortError

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 240.0
"""Seconds of the wall past which something hangs, however busy the computer is."""
PLANRUNNER = [sys.executable, "-m", "planrunner", "simulate-bench"]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are not for Windows")


def started(folder: Path, *more: str, bench: str = "lab_simulated") -> tuple[subprocess.Popen[str], dict[str, Any]]:
    """A process that serves the shipped bench at addresses of its own, and what it says when it is ready."""
    ready = folder / "ready.json"
    command = [*PLANRUNNER, bench, "--copy", str(folder / "bench.yaml"), "--ready", str(ready), *more]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
    deadline = time.monotonic() + PATIENCE
    while not ready.exists():
        if process.poll() is not None or time.monotonic() > deadline:
            process.kill()
            pytest.fail(f"it does not begin: {process.communicate()[0]}")
        time.sleep(0.05)
    return process, json.loads(ready.read_text(encoding="utf-8"))


def patient(bench: str) -> str:
    """The text of a shipped simulated bench with patience for a busy computer."""
    for key, more in (("baud", "silence: 1 min"), ("axes", "timeout: 1 min"), ("lowest", "timeout: 1 min")):
        bench = bench.replace(f"    {key}:", f"    {more}\n    {key}:")
    return bench


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    folder = tmp_path_factory.mktemp("bench")
    process, note = started(folder, "--speed", "20")
    yield {**note, "folder": folder}
    process.terminate()
    process.communicate(timeout=PATIENCE)


def connected(address: str) -> socket.socket:
    return socket.create_connection(("127.0.0.1", Address.of(address).port), timeout=PATIENCE)


def said(connection: socket.socket, message: str) -> bytes:
    connection.sendall(message.encode() + b"\n")
    return connection.recv(4096)


def until(control: str, what: Any, patience: float = PATIENCE) -> dict[str, Any]:
    """The state of the bench as soon as it is so."""
    deadline = time.monotonic() + patience
    while not what(state := ask(control, {"ask": "state"})):
        assert time.monotonic() < deadline, state
        time.sleep(0.02)
    return state


def frames_of(link: str, count: int) -> bytes:
    """So many bytes from the line, without a gap: the line is emptied, then takes as many before any is dropped."""
    import fcntl
    import termios

    file = os.open(link, os.O_RDONLY | os.O_NOCTTY)
    try:
        termios.tcflush(file, termios.TCIFLUSH)
        waiting, data = bytes(4), b""
        while int.from_bytes(waiting, sys.byteorder) < count:
            time.sleep(0.005)
            waiting = fcntl.ioctl(file, termios.FIONREAD, bytes(4))
        while len(data) < count:
            data += os.read(file, 4096)
        return data
    finally:
        os.close(file)


def test_table_and_chamber_answer_and_move_one_world(served: dict[str, Any]) -> None:
    with connected(served["addresses"]["table"]) as table, connected(served["addresses"]["chamber"]) as chamber:
        assert said(table, "*IDN?")[:8] == bytes(4) + (len("ACUTRONIC,ACUTROL3000,simulated,1.0") + 1).to_bytes(
            4, "big"
        )
        assert said(chamber, ":SOURCE:CLOOP1:PVALUE?") == b"25.000\n"
        table.sendall(b":int:reset;close all\n:dem:rate 1,10\n:mode:rate 1\n")
        state = until(served["control"], lambda state: state["table"]["rates"][0] > 0.17)
        assert state["table"]["powered"] == [True, True, True]
        table.sendall(b":mode:off all\n:int:open all\n")
        until(served["control"], lambda state: state["table"]["rates"][0] == 0)


def test_the_line_carries_frames_that_check(served: dict[str, Any]) -> None:
    """CRC-16 XMODEM: a frame followed by its check leaves nothing, shifted bit by bit."""
    data = frames_of(served["addresses"]["gyro"], 2000)
    start = data.index(b"\xa5\x5a")
    counters = []
    for place in range(start, len(data) - 16, 16):
        frame = data[place : place + 16]
        register = 0
        for byte in frame[2:]:
            register ^= byte << 8
            for _ in range(8):
                register = (register << 1 ^ (0x1021 if register & 0x8000 else 0)) & 0xFFFF
        assert register == 0
        counters.append(int.from_bytes(frame[12:14], "big"))
    assert len(counters) > 100
    assert {(b - a) % 65536 for a, b in pairwise(counters)} == {1}


def test_the_sensor_feels_the_chamber_and_the_table(served: dict[str, Any]) -> None:
    state = until(served["control"], lambda state: state["line"]["frames"] > 0)
    assert state["chamber"]["air"] == pytest.approx(298.15, abs=0.01)


def test_faults_are_declared_while_it_runs(served: dict[str, Any]) -> None:
    control, token = served["control"], served["token"]
    told = ask(control, {"inject": "{instrument: table, fault: interlock open, for: 1 d}"}, token)
    until(control, lambda state: [item["begun"] for item in state["faults"]] == [True])
    with connected(served["addresses"]["table"]) as table:
        assert said(table, ":interlock? 1").endswith(b"Fault\n")
        ask(control, {"clear": told["fault"]}, token)
        until(control, lambda state: not state["faults"])
        table.sendall(b":int:reset\n")
        assert said(table, ":interlock? 1").endswith(b"Open\n")
    with pytest.raises(InstrumentError, match="cannot have the fault"):
        ask(control, {"inject": {"instrument": "gyro", "fault": "stuck"}}, token)
    with pytest.raises(InstrumentError, match="one of ask"):
        ask(control, {"dance": True}, token)


def heard(control: str, data: bytes) -> bytes:
    """All that is answered to these bytes until the other side hangs up."""
    host, _, port = control.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(4096), b""))


INJECT = b'{"inject": {"instrument": "gyro", "fault": "silent", "for": "1 d"}}\n'


@pytest.mark.parametrize(
    "lines",
    [
        pytest.param(
            b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\n\r\n" + INJECT, id="a page's post"
        ),
        pytest.param(INJECT, id="no token"),
        pytest.param(INJECT.replace(b"{", b'{"token": "guessed", ', 1), id="a wrong token"),
        pytest.param(INJECT.replace(b"{", b'{"token": ["a"], "ask": "dance", ', 1), id="a question beside it"),
        pytest.param(b"[" * 60_000 + b"\n" + INJECT, id="deep"),
        pytest.param(b'{"stop": true}\n', id="stop"),
    ],
)
def test_nobody_without_the_token_changes_anything(served: dict[str, Any], lines: bytes) -> None:
    """The connection ends at the first line that is refused: whatever follows it is not read, also with the token."""
    command = INJECT.replace(b"{", b'{"token": "' + served["token"].encode() + b'", ', 1)
    answer = heard(served["control"], lines + command)
    assert answer.startswith(b'{"error": ') and answer.count(b"\n") == 1
    assert ask(served["control"], {"ask": "state"})["faults"] == []


def test_questions_and_the_token_keep_a_connection(served: dict[str, Any]) -> None:
    token = json.dumps(served["token"]).encode()
    answers = heard(served["control"], b'{"ask": "bench"}\n{"clear": "all", "token": %s}\n{"ask": "state"}\n' % token)
    assert [*map(set, map(json.loads, answers.splitlines()))][1] == {"cleared"} and answers.count(b"\n") == 3


def test_the_command_line_takes_the_token_from_the_readiness_file(
    served: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ready, bench = served["folder"] / "ready.json", str(served["folder"] / "bench.yaml")
    assert ready.stat().st_mode & 0o077 == 0
    fault = "{instrument: gyro, fault: silent, for: 1 d}"
    assert main(["simulate-bench", bench, "--ready", str(ready), "--inject", fault]) == 0
    assert capsys.readouterr().out.startswith("fault: ")
    assert main(["simulate-bench", bench, "--ready", str(ready), "--clear", "all"]) == 0
    (tmp_path / "other.json").write_text(
        ready.read_text(encoding="utf-8").replace("127.0.0.1:", "127.0.0.1:1"), "utf-8"
    )
    (tmp_path / "none.json").write_text("[]", encoding="utf-8")
    os.mkfifo(tmp_path / "pipe.json")
    for more in ([], *(["--ready", str(tmp_path / f"{name}.json")] for name in ("missing", "none", "other", "pipe"))):
        assert main(["simulate-bench", bench, "--stop", *more]) == WRONG_INPUT
        assert "error[simulation-token]" in capsys.readouterr().err
    until(served["control"], lambda state: not state["faults"])


def test_a_port_that_refuses_comes_back(served: dict[str, Any]) -> None:
    control, address, token = served["control"], served["addresses"]["chamber"], served["token"]
    number = ask(control, {"inject": {"instrument": "chamber", "fault": "refuse"}}, token)["fault"]
    until(control, lambda state: state["faults"] and state["faults"][0]["begun"])
    with pytest.raises(ConnectionRefusedError):
        connected(address).close()
    ask(control, {"clear": number}, token)
    until(control, lambda state: not state["faults"])
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            with connected(address) as chamber:
                assert said(chamber, ":SOURCE:CLOOP1:ERROR?") == b"NONE\n"
            return
        except ConnectionRefusedError:
            assert time.monotonic() < deadline
            time.sleep(0.02)


def test_a_line_that_is_unplugged_comes_back(served: dict[str, Any]) -> None:
    control, link, token = served["control"], Path(served["addresses"]["gyro"]), served["token"]
    number = ask(control, {"inject": {"instrument": "gyro", "fault": "unplug"}}, token)["fault"]
    until(control, lambda state: state["faults"] and state["faults"][0]["begun"])
    assert not link.is_symlink()
    ask(control, {"clear": number}, token)
    until(control, lambda state: not state["faults"])
    assert frames_of(str(link), 100)


def test_what_nobody_fetches_is_dropped(served: dict[str, Any]) -> None:
    before = ask(served["control"], {"ask": "state"})["line"]["bytes_dropped"]
    until(served["control"], lambda state: state["line"]["bytes_dropped"] > before)


def test_a_run_takes_its_clock_from_the_simulated_bench(served: dict[str, Any]) -> None:
    bench, _, _ = read_bench(str(served["folder"] / "bench.yaml"))
    with open_bench(bench) as opened:
        assert isinstance(opened.clock, Hastens)
        assert opened.clock.speed == 20
        assert opened.table is not None and "ACUTRO" in opened.table.identify()["model"]
    elsewhere = SimulationSpec(bench="virtual", control=served["control"])
    with pytest.raises(InstrumentError, match="the bench file says TCPIP"):
        attach(elsewhere, {"table": "TCPIP::127.0.0.1::9878::SOCKET"})


def test_without_a_simulated_bench_a_run_says_how_to_start_it() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # held, but not listened at
        with pytest.raises(InstrumentError, match="planrunner simulate-bench"):
            ask(f"127.0.0.1:{free.getsockname()[1]}", {"ask": "bench"})


def test_it_ends_cleanly_when_it_is_terminated(tmp_path: Path) -> None:
    script = tmp_path / "faults.yaml"
    script.write_text(
        "planrunner_faults: 1\nfaults: [{instrument: gyro, fault: silent, at: 1 min}]\n", encoding="utf-8"
    )
    process, note = started(tmp_path, "--faults", str(script))
    assert ask(note["control"], {"ask": "state"})["faults"][0]["fault"] == "silent"
    link = Path(note["addresses"]["gyro"])
    assert link.is_symlink()
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    assert not link.is_symlink() and not (tmp_path / "ready.json").exists()
    with pytest.raises(ConnectionRefusedError):
        connected(note["addresses"]["table"]).close()


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("TCPIP::192.168.0.5::5025::SOCKET", "another computer"),
        ("GPIB0::3::INSTR", "cannot be simulated"),
        ("socket://10.0.0.1:4001", "another computer"),
    ],
)
def test_only_this_computer_is_served(address: str, told: str) -> None:
    with pytest.raises(PortError, match=told):
        Address.of(address)


@pytest.mark.parametrize(
    "text",
    [
        "TCPIP::127.0.0.1::9878::SOCKET",
        "socket://127.0.0.1:4001",
        "simulated/gyro",
        "ASRL/tmp/x::INSTR",
        "/dev/ttyUSB0",
    ],
)
def test_addresses_are_written_as_they_were(text: str) -> None:
    assert Address.of(text).written() == text


def test_benches_that_cannot_be_simulated_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "plans" / "benches" / "lab_simulated.yaml").read_text(encoding="utf-8")
    text = text.replace("simulated/gyro", str(tmp_path / "gyro"))
    bench = tmp_path / "bench.yaml"

    def refused(changed: str) -> tuple[int, str]:
        bench.write_text(changed, encoding="utf-8")
        code = main(["simulate-bench", str(bench)])
        told = "".join(capsys.readouterr())
        assert "internal error" not in told
        return code, told

    assert refused(text.replace("simulation: {", "# {"))[0] == WRONG_INPUT
    code, told = refused(text.replace("bench: virtual,", "bench: virtual_gyro_triad,"))
    assert code == WRONG_INPUT and "meaning-simulation" in told
    code, told = refused(text.replace("sample_rate: 100 Hz", "sample_rate: 200 Hz"))
    assert code == WRONG_INPUT and "100 Hz at most" in told
    code, told = refused(text.replace("torquer_y:", "torquer_z:"))
    assert code == WRONG_INPUT and "no output 'torquer_z'" in told
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        code, told = refused(text.replace("::9878::", f"::{taken.getsockname()[1]}::"))
        assert code == FAULT and "in use" in told
    (tmp_path / "gyro").write_text("mine", encoding="utf-8")
    code, told = refused(text.replace("9878", "0").replace("5025", "0"))
    assert code == FAULT and "choose another name" in told
    assert (tmp_path / "gyro").read_text(encoding="utf-8") == "mine"
