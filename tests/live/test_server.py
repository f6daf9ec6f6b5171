"""The server of the live page, asked as a browser, another site, and a stranger would ask it."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from running_run import QUESTION, RunningRun, close_all

from planrunner.archive.live import take_answer
from planrunner.archive.pausing import asked_to_pause
from planrunner.base.findings import InputError
from planrunner.live.monitor import Monitor
from planrunner.live.server import FILES, MOST_BODY, LiveServer

PATIENCE = 240.0


@dataclass
class Asked:
    """A server with one running run."""

    server: LiveServer
    run: RunningRun

    def __call__(
        self, method: str, path: str, body: object = None, **headers: str | None
    ) -> tuple[int, str, Mapping[str, str]]:
        """As the page asks; headers given as None are left out."""
        own = f"127.0.0.1:{self.server.port}"
        sent: dict[str, str | None] = {"Host": own, "Authorization": f"Bearer {self.server.token}"}
        data = None
        if method == "POST":
            sent |= {"Origin": f"http://{own}", "Content-Type": "application/json"}
            data = body if isinstance(body, bytes) else json.dumps(body).encode()
        sent |= {name.replace("_", "-"): value for name, value in headers.items()}
        connection = http.client.HTTPConnection("127.0.0.1", self.server.port, timeout=PATIENCE)
        try:
            connection.putrequest(method, path, skip_host=True)
            for name, value in sent.items():
                if value is not None:
                    connection.putheader(name, value)
            if data is not None and "Content-Length" not in sent:
                connection.putheader("Content-Length", str(len(data)))
            connection.endheaders(data)
            answer = connection.getresponse()
            return answer.status, answer.read().decode(), dict(answer.getheaders())
        finally:
            connection.close()


@pytest.fixture
def ask(tmp_path: Path) -> Iterator[Asked]:
    run = RunningRun(tmp_path)
    with LiveServer(Monitor(tmp_path)) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield Asked(server, run)
        finally:
            server.shutdown()
            thread.join()
            close_all()


def test_the_server_is_reached_from_this_computer_only(ask: Asked) -> None:
    assert ask.server.server_address[0] == "127.0.0.1"


def test_the_page_and_its_files_contain_no_data_and_forbid_everything_else(ask: Asked) -> None:
    for path in FILES:
        status, text, headers = ask("GET", path, Authorization=None)
        assert status == 200 and ask.run.path.name not in text and ask.server.token not in text
        policy = headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "unsafe" not in policy and "frame-ancestors 'none'" in policy
        assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("path", ["/api/activity", "/api/events", "/api/other", "/../live.html", "/run.json"])
@pytest.mark.parametrize("authorization", [None, "", "Bearer", "Bearer wrong", "Basic x", "Bearer ü"])
def test_nothing_else_is_given_without_the_token(ask: Asked, path: str, authorization: str | None) -> None:
    status, text, _ = ask("GET", path, Authorization=authorization)
    assert status == 401 and ask.run.path.name not in text


def test_the_activity_is_given_with_the_token(ask: Asked) -> None:
    status, text, headers = ask("GET", "/api/activity")
    (run,) = json.loads(text)["running"]
    assert status == 200 and run["run"] == ask.run.path.name and headers["Cache-Control"] == "no-store"
    assert ask("GET", "/api/other")[0] == ask("GET", "/../../etc/passwd")[0] == 404


@pytest.mark.parametrize("host", [None, "", "example.org", "127.0.0.1", "localhost:1", "127.0.0.1.example.org:80"])
@pytest.mark.parametrize("path", ["/", "/api/activity"])
def test_another_host_is_refused(ask: Asked, path: str, host: str | None) -> None:
    """A site whose name resolves to 127.0.0.1 sends its own name."""
    assert ask("GET", path, Host=host)[0] in (400, 421)


def test_the_name_localhost_is_accepted(ask: Asked) -> None:
    assert ask("GET", "/api/activity", Host=f"localhost:{ask.server.port}")[0] == 200


@pytest.mark.parametrize("origin", [None, "null", "https://example.org", "http://127.0.0.1", "http://127.0.0.1:1"])
def test_an_action_of_another_site_is_refused(ask: Asked, origin: str | None) -> None:
    assert ask("POST", "/api/pause", {"run": ask.run.path.name}, Origin=origin)[0] == 403
    assert not asked_to_pause(ask.run.writer.folder)


def test_a_run_is_paused_continued_and_answered(ask: Asked) -> None:
    name, folder = ask.run.path.name, ask.run.writer.folder
    assert ask("POST", "/api/pause", {"run": name})[0] == 200 and asked_to_pause(folder)
    assert ask("POST", "/api/continue", {"run": name})[0] == 200 and not asked_to_pause(folder)
    ask.run.show(question=QUESTION)
    assert ask("POST", "/api/answer", {"run": name, "question": QUESTION.id, "by": "Li Wei"})[0] == 200
    answer = take_answer(folder, QUESTION.id)
    assert answer is not None and answer.by == "Li Wei"


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"", 400),
        (b"{", 400),
        (b"[" * 4000, 400),
        ([], 400),
        ({}, 400),
        ({"run": 1}, 400),
        ({"run": "x", "more": "y"}, 400),
        ({"run": "no such run"}, 409),
        ({"run": "../x"}, 409),
        ({"run": "x" * MOST_BODY}, 413),
    ],
)
def test_a_wrong_body_is_refused(ask: Asked, body: object, status: int) -> None:
    assert ask("POST", "/api/pause", body)[0] == status


def test_wrong_requests_are_refused(ask: Asked) -> None:
    name = {"run": ask.run.path.name}
    assert ask("POST", "/api/pause", name, Authorization=None)[0] == 401
    assert ask("POST", "/api/pause", name, Content_Type="text/plain")[0] == 415
    assert ask("POST", "/api/pause", b"", Content_Length="-1")[0] == 413
    assert ask("POST", "/api/pause", b"", Content_Length="x")[0] == 411
    assert ask("POST", "/api/activity", name)[0] == 404
    assert ask("PUT", "/api/pause")[0] == ask("OPTIONS", "/api/pause")[0] == 501
    assert not asked_to_pause(ask.run.writer.folder)


def test_events_follow_the_run(ask: Asked) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", ask.server.port, timeout=PATIENCE)
    connection.request("GET", "/api/events", headers={"Authorization": f"Bearer {ask.server.token}"})
    answer = connection.getresponse()
    assert answer.status == 200 and answer.getheader("Content-Type") == "text/event-stream"

    def event() -> list[str]:
        while not (line := answer.readline().decode()).startswith("data: "):
            assert line
        return [run["live"]["segment"]["label"] for run in json.loads(line[6:])["running"]]

    assert event() == ["P3"]
    ask.run.show(label="P4")
    while event() != ["P4"]:
        pass
    ask.run.end()
    while event() != []:
        pass
    connection.close()


def test_a_port_that_is_taken_is_named(ask: Asked, tmp_path: Path) -> None:
    ask.server.allow_reuse_address = False
    with pytest.raises(InputError, match="is not available"):
        LiveServer(Monitor(tmp_path), ask.server.port)
    with pytest.raises(InputError, match="is not available"):
        LiveServer(Monitor(tmp_path), 70_000)
