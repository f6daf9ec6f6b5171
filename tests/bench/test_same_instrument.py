"""Two addresses of one instrument have a name in common; those of two have none."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from planrunner.bench.same_instrument import names_of, windows_port

ALIKE = [
    ("TCPIP::127.0.0.1::5025::SOCKET", "tcpip0::localhost::5025::socket"),
    ("TCPIP::127.0.0.1::5025::SOCKET", "socket://127.0.0.1:5025"),
    ("socket://localhost:4001?logging=debug", "ASRLsocket://127.0.0.1:4001::INSTR"),
    ("rfc2217://127.0.0.1:4001", "socket://127.1:04001/"),
    ("socket://[::ffff:127.0.0.1]:7", "TCPIP::127.0.0.1::7::SOCKET"),
    ("TCPIP::127.0.0.1::INSTR", "TCPIP0::localhost::INST0::INSTR"),
    ("TCPIP::No-Such-Host.invalid::1::SOCKET", "socket://no-such-host.invalid:1"),
    ("GPIB0::3::INSTR", "gpib::3"),
    ("USB0::0x1AB1::0x04CE::DS1::INSTR", "USB::6833::0x4ce::DS1::0::INSTR"),
    ("paper /x/table.json", " paper /x/table.json"),
    ("/dev/ttyUSB77", "ASRL/dev/../dev/ttyUSB77"),
]
APART = [
    ("TCPIP::127.0.0.1::5025::SOCKET", "TCPIP::127.0.0.1::5026::SOCKET"),
    ("TCPIP::127.0.0.1::5025::SOCKET", "TCPIP::127.0.0.2::5025::SOCKET"),
    ("TCPIP::127.0.0.1::gpib0,3::INSTR", "TCPIP::127.0.0.1::gpib0,4::INSTR"),
    ("GPIB0::3::INSTR", "GPIB1::3::INSTR"),
    ("GPIB0::3::INSTR", "GPIB0::3::1::INSTR"),
    ("USB0::0x1AB1::0x04CE::DS1::INSTR", "USB0::0x1AB1::0x04CE::DS2::INSTR"),
    ("/dev/ttyUSB7", "/dev/ttyUSB8"),
    ("paper one", "paper two"),
]


@pytest.mark.parametrize(("one", "other"), ALIKE)
def test_alike(one: str, other: str) -> None:
    assert names_of(one) & names_of(other)


@pytest.mark.parametrize(("one", "other"), APART)
def test_apart(one: str, other: str) -> None:
    assert names_of(one) and names_of(other) and not names_of(one) & names_of(other)


@pytest.mark.skipif(sys.platform == "win32", reason="device nodes are POSIX")
def test_a_second_node_of_a_device_is_the_same_port(tmp_path: Path) -> None:
    """As a container may have it."""
    if os.geteuid() != 0:
        pytest.skip("only an administrator makes device nodes")
    node = tmp_path / "port"
    try:
        os.mknod(node, 0o600 | 0o020000, os.makedev(1, 3))
    except OSError:
        pytest.skip("no device nodes here")
    assert names_of(str(node)) & names_of("/dev/null")


def test_what_only_a_driver_understands_means_the_same_in_every_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = names_of("paper /x/table.json")
    monkeypatch.chdir(tmp_path)
    assert names_of("paper /x/table.json") == here


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX paths")
def test_the_two_devices_of_a_port_on_macos() -> None:
    assert names_of("/dev/tty.usbserial-1") & names_of("/dev/cu.usbserial-1")


def test_ports_of_windows() -> None:
    assert windows_port("com3") == windows_port(r"\\.\COM3") == windows_port("3", numbered=True) == {"COM3"}
    assert windows_port("3") == {"3"}
