"""`planrunner bench ping`: every instrument says who it is; one that fails does not keep the next from being asked."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from scripted import answering, closed_port

from planrunner.cli import main

BENCH = """planrunner_bench: 1
name: laboratory
site: {{latitude: 39.98 deg, gravity: 9.80154 m/s^2}}
instruments:
  chamber: {{driver: espec_p300, address: "{chamber}", timeout: 1 min, lowest: -40 degC, highest: 85 degC, ramp: 3 K/min}}
  table:
    {{driver: acutrol, address: "{table}", timeout: 1 min,
     axes: [{{name: table, direction: up, max_rate: 100 deg/s, max_acceleration: 200 deg/s^2}}]}}
"""
P300 = {
    "TYPE?": b"T,T,S2,160.0\r\n",
    "TEMP?": b"23.4,25.0,90.0,-45.0\r\n",
    "MON?": b"23.4,,CONSTANT,1\r\n",
    "ALARM?": b"1,3\r\n",
}


@pytest.fixture(autouse=True)
def _own_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANRUNNER_LOCKS", str(tmp_path / "locks"))


@pytest.fixture
def refusing() -> Iterator[str]:
    """An address at which nothing answers."""
    with closed_port() as port:
        yield f"TCPIP::127.0.0.1::{port}::SOCKET"


def bench_file(folder: Path, chamber: str, table: str) -> str:
    path = folder / "lab.yaml"
    path.write_text(BENCH.format(chamber=chamber, table=table), encoding="utf-8")
    return str(path)


def test_who_answers_is_reported_and_who_does_not_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], refusing: str
) -> None:
    heard = []

    def answer(message: str) -> bytes:
        heard.append(message)
        return P300[message]

    with answering(answer, b"\r\n") as server:
        assert main(["bench", "ping", bench_file(tmp_path, server.address, refusing)]) == 3
    chamber_row, table_row = capsys.readouterr().out.splitlines()
    assert chamber_row.startswith(
        "chamber      espec_p300           Espec P300 or SCP-220 T,T,S2,160.0 | air_degC 23.4 | "
    )
    assert chamber_row.endswith(" ms | reports alarms of the P300 (number, codes): 1,3")
    assert table_row.startswith(
        f"table        acutrol              FAILED: {refusing}, when asked '*IDN?', refuses the connection"
    )
    assert not [message for message in heard if "?" not in message]  # nothing is set, nothing moves


def test_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str], refusing: str) -> None:
    with answering(lambda message: P300[message], b"\r\n") as server:
        main(["bench", "ping", bench_file(tmp_path, server.address, refusing), "--json"])
    chamber, table = json.loads(capsys.readouterr().out)["instruments"]
    assert chamber["readings"] == {"air_degC": 23.4}
    assert chamber["faults"] and not chamber["failure"]
    assert chamber["round_trip_s"] > 0
    assert table["failure"] and table["round_trip_s"] is None


def test_a_simulated_bench_answers(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "ping", "virtual"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_a_bench_that_is_none_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str], refusing: str) -> None:
    assert main(["bench", "ping", str(tmp_path / "none.yaml")]) == 2
    path = bench_file(tmp_path, "192.168.0.5:5025", refusing)
    assert main(["bench", "ping", path]) == 2
    assert "lab.yaml:5:42: error[form-text]: '192.168.0.5:5025' is not a VISA resource name" in capsys.readouterr().err


def test_checking_a_bench_of_real_instruments_loads_no_link(tmp_path: Path) -> None:
    bench = bench_file(tmp_path, "ASRL3::INSTR", "GPIB0::1::INSTR")
    code = (
        "import sys; from planrunner.bench.model import read_bench, models; models(read_bench(sys.argv[1])[0]);"
        "print(sorted({'pyvisa', 'serial', 'scipy', 'numba'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code, bench], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
