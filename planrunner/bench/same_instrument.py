"""Finds all names of the address of an instrument on this computer. Two addresses of the same instrument have a name in common.

A serial port has several names (`/dev/ttyUSB0`, a link in `/dev/serial/by-id`, `ASRL/dev/ttyUSB0::INSTR`; `COM3` and
`ASRL3::INSTR`), and so has a network host. Two connections of the same instrument, such as GPIB and network, or two ports of a
host, have no name in common. This module cannot recognise that they belong to the same instrument.
"""

from __future__ import annotations

import ipaddress
import os
import re
import socket
import stat
import sys

_SOCKET = re.compile(r"TCPIP\d*::([^:\s]+)::(\d+)::SOCKET", re.IGNORECASE)
_NETWORK = re.compile(r"TCPIP\d*::([^:\s]+?)(?:::([^:\s]+))?(?:::INSTR)", re.IGNORECASE)
_BUS = re.compile(r"GPIB(\d*)::(\d+)(?:::(\d+))?(?:::INSTR)?", re.IGNORECASE)
_USB = re.compile(r"USB\d*::(\w+)::(\w+)::([^:\s]+)(?:::\d+)?::(?:INSTR|RAW)", re.IGNORECASE)
_VISA_SERIAL = re.compile(r"ASRL(.+?)(?:::INSTR)?", re.IGNORECASE)
_URL = re.compile(r"(\w+)://([^?#]*)(?:[?#].*)?")
_HOST_AND_PORT = re.compile(r"\[?([^\]/]+)\]?:(\d+)/?")


def names_of(address: str) -> frozenset[str]:
    """Returns all names under which the instrument at `address` can be addressed on this computer. An address is a VISA resource, a
    serial port as pyserial names it, or a text that only the driver of the instrument understands. In the last case, the text is
    the only name of the instrument. The result is never empty: for an unknown host, it contains the name of the host."""
    text = address.strip()
    if found := _SOCKET.fullmatch(text):
        return _of_host(found[1], f"port {int(found[2])}")
    if found := _NETWORK.fullmatch(text):
        return _of_host(found[1], (found[2] or "inst0").lower())
    if found := _BUS.fullmatch(text):
        return frozenset({f"gpib {int(found[1] or 0)} {int(found[2])} {found[3] or ''}".rstrip()})
    if found := _USB.fullmatch(text):
        return frozenset({f"usb {_number(found[1])} {_number(found[2])} {found[3]}"})
    if found := _VISA_SERIAL.fullmatch(text):
        return _of_port(found[1], numbered=True)
    return _of_port(text)


def _of_host(host: str, where: str) -> frozenset[str]:
    return frozenset(f"host {name} {where}" for name in _addresses(host))


def _addresses(host: str) -> set[str]:
    """Returns all network addresses that belong to a host."""
    try:
        found = {str(entry[4][0]).partition("%")[0] for entry in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):
        return {host.lower()}
    return {_plain(address) for address in found} or {host.lower()}


def _plain(address: str) -> str:
    known = ipaddress.ip_address(address)
    mapped = known.ipv4_mapped if isinstance(known, ipaddress.IPv6Address) else None
    return str(mapped or known)


def _number(text: str) -> str:
    try:
        return str(int(text, 0))
    except ValueError:
        return text.lower()


def _of_port(name: str, numbered: bool = False) -> frozenset[str]:
    """Returns all names that this computer has for a serial port. `numbered`: True if a plain number is the name of the Windows
    port with this number."""
    if url := _URL.fullmatch(name):
        return _of_url(name, url[1].lower(), url[2])
    if sys.platform == "win32":
        return windows_port(name, numbered)
    if not os.path.isabs(name) and not os.path.exists(name):
        return frozenset({name})  # not a port, but a text that only its driver understands
    path = os.path.abspath(name)
    real = os.path.realpath(path)
    names = {path, real, _calling_out(path), _calling_out(real)}
    try:
        known = os.stat(real)
    except OSError:  # it may be plugged in later
        known = None
    if known is not None and stat.S_ISCHR(known.st_mode):
        names.add(f"device {os.major(known.st_rdev)}:{os.minor(known.st_rdev)}")
    return frozenset(names)


def windows_port(name: str, numbered: bool = False) -> frozenset[str]:
    r"""Returns the same name for all spellings of a Windows port: `\\.\com3`, `COM3` or, in a VISA resource, `3`."""
    plain = name.upper().removeprefix("\\\\.\\")
    return frozenset({f"COM{plain}" if numbered and plain.isdecimal() else plain})


def _calling_out(path: str) -> str:
    """Returns the device for outgoing calls that macOS provides for a serial port. macOS has two devices for each port; the other
    device waits for a carrier."""
    return path.replace("/dev/tty.", "/dev/cu.", 1)


def _of_url(name: str, scheme: str, rest: str) -> frozenset[str]:
    if scheme in ("socket", "rfc2217") and (found := _HOST_AND_PORT.fullmatch(rest)):
        return _of_host(found[1], f"port {int(found[2])}")
    if scheme in ("spy", "alt"):  # pyserial's ways of looking at, or driving, a port of the computer
        return _of_port(rest)
    if scheme == "hwgrep":
        from serial.tools import list_ports

        found_ports = [str(port.device) for port in list_ports.grep(rest.partition("&")[0])]
        return frozenset().union({name}, *map(_of_port, found_ports))
    return frozenset({name})
