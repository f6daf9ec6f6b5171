"""Notifications against servers that the tests start on loopback: HTTP and SMTP."""

from __future__ import annotations

import hashlib
import hmac
import json
import socket
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from planrunner.night.notify import NotificationError, receiver, send, wanted
from planrunner.night.suite import Notification

NIGHT: dict[str, Any] = {
    "title": "Night\r\nBcc: evil@example.org", "suite": "s.yaml", "clock": "virtual", "state": "finished", "begins": "b", "ends": "e",
    "foreseen_end": "f", "exit_code": 1, "counts": {"failed": 1}, "check_standards": [], "fleet": [], "remarks": [], "notifications": [],
    "tests": [{"test": "x/a", "state": "failed", "reason": "7 °/h, required ±5", "run": "r"}],
}  # fmt: skip


@contextmanager
def web(
    status: int = 200, headers: dict[str, str] | None = None
) -> Iterator[tuple[str, list[tuple[dict[str, str], bytes]]]]:
    got: list[tuple[dict[str, str], bytes]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            got.append((dict(self.headers), self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(status)
            for name, value in (headers or {}).items():
                self.send_header(name, value)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/hook", got
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def mail(refuse: bool = False) -> Iterator[tuple[str, list[str]]]:
    """A server that speaks as much of RFC 5321 as a client needs."""
    got: list[str] = []

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            self.wfile.write(b"220 test\r\n")
            while line := self.rfile.readline():
                word = line.split()[0].upper()
                got.append(line.decode().strip())
                if word == b"DATA":
                    self.wfile.write(b"354 go\r\n")
                    while (text := self.rfile.readline()) != b".\r\n":
                        got.append(text.decode().rstrip("\r\n"))
                self.wfile.write(
                    b"550 no\r\n"
                    if refuse and word == b"RCPT"
                    else b"221 bye\r\n"
                    if word == b"QUIT"
                    else b"250 ok\r\n"
                )
                if word == b"QUIT":
                    return

    server = socketserver.TCPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"127.0.0.1:{server.server_address[1]}", got
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_a_webhook_receives_the_night_signed() -> None:
    with web() as (address, got):
        send(Notification(webhook_from="HOOK", secret_from="KEY"), NIGHT, {"HOOK": address, "KEY": "secret"})
    headers, body = got[0]
    assert json.loads(body)["night"] == NIGHT and "x/a" in json.loads(body)["summary"]
    assert headers["X-Planrunner-Signature"] == "sha256=" + hmac.new(b"secret", body, hashlib.sha256).hexdigest()


@pytest.mark.parametrize(("status", "headers"), [(500, {}), (302, {"Location": "http://127.0.0.1:1/"}), (404, {})])
def test_a_webhook_that_does_not_accept_is_said_and_no_redirect_is_followed(
    status: int, headers: dict[str, str]
) -> None:
    with web(status, headers) as (address, got), pytest.raises(NotificationError, match="did not accept"):
        send(Notification(webhook=address), NIGHT, {})
    assert len(got) == 1


def test_a_server_that_cannot_be_reached_and_a_missing_secret_are_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as bound:
        port = bound.getsockname()[1]
    with pytest.raises(NotificationError, match="did not accept"):
        send(Notification(webhook=f"http://127.0.0.1:{port}/secret-path"), NIGHT, {})
    with pytest.raises(NotificationError, match="HOOK is not set"):
        send(Notification(webhook_from="HOOK"), NIGHT, {})
    with pytest.raises(NotificationError, match="http://"):
        send(Notification(webhook_from="HOOK"), NIGHT, {"HOOK": "file:///etc/passwd"})
    assert "secret" not in receiver(Notification(webhook_from="HOOK"))


def test_an_e_mail_is_sent_to_all_receivers_and_its_title_adds_no_header() -> None:
    with mail() as (server, got):
        entry = Notification(
            email=("a@example.org", "b@example.org"), sender="lab@example.org", server=server, security="none"
        )
        send(entry, NIGHT, {})
    assert [line for line in got if line.startswith("rcpt")] == ["rcpt TO:<a@example.org>", "rcpt TO:<b@example.org>"]
    assert not [line for line in got if line.lower().startswith("bcc:")]
    assert any(line.startswith("Subject: Night Bcc: evil@example.org: 1 failed") for line in got)


def test_a_mail_server_that_refuses_or_offers_no_encryption_is_said() -> None:
    def entry(server: str, security: str = "starttls") -> Notification:
        return Notification(email=("a@example.org",), sender="lab@example.org", server=server, security=security)

    with mail(refuse=True) as (server, _), pytest.raises(NotificationError, match="550"):
        send(entry(server, "none"), NIGHT, {})
    with mail() as (server, got), pytest.raises(NotificationError, match="STARTTLS"):
        send(entry(server), NIGHT, {})
    assert not [line for line in got if line.startswith("mail")]


def test_only_failed_nights_are_told_on_request() -> None:
    assert wanted(Notification(when="always"), 0) and wanted(Notification(when="failed"), 3)
    assert not wanted(Notification(when="failed"), 0)
