"""The server of the live page. The server listens only on the loopback interface, requires a token, and makes no external request.

The page and its script contain no data and need no token. All data and actions need the token in the `Authorization` header. The
page takes the token from the fragment of its address, which browsers do not send. A cookie would not be secret, because browsers
would send it to every other server on this computer as well. The server refuses requests whose `Host` is not this server, and
actions whose `Origin` is not this page. Therefore another site cannot reach the server through the browser, even if the name of
this site resolves to 127.0.0.1.
"""

from __future__ import annotations

import hmac
import http
import json
import secrets
import threading
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import MappingProxyType

from planrunner import __version__
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import InputError, Mark
from planrunner.base.shipped import shipped_bytes
from planrunner.live.monitor import Activity, Monitor

LOOPBACK = "127.0.0.1"
EVERY = 1.0
"""Time between two readings of the archive while a page is open, s."""
KEEP_ALIVE = 15.0
"""Time after which a line is sent even if nothing has changed, s."""
MOST_BODY = 4096
"""Maximum size in bytes of the body of a request."""
MOST_WATCHERS = 16
"""Maximum number of pages that are open at the same time."""
TIMEOUT = 30.0
"""Maximum time in which a request must arrive, s."""

FILES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "/": ("live.html", "text/html; charset=utf-8"),
        "/live.js": ("live.js", "text/javascript; charset=utf-8"),
        "/strip.js": ("strip.js", "text/javascript; charset=utf-8"),
        "/page.css": ("page.css", "text/css; charset=utf-8"),
        "/uPlot.js": ("vendor/uPlot.iife.min.js", "text/javascript; charset=utf-8"),
        "/uPlot.css": ("vendor/uPlot.min.css", "text/css; charset=utf-8"),
    }
)
"""The only files that the server sends: for each path, the shipped file and its type."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class _Watching:
    """Observes the archive for all open pages together, and only while a page is open."""

    def __init__(self, monitor: Monitor):
        self._monitor = monitor
        self._condition = threading.Condition()
        self._watchers = 0
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self.number = 0
        self.text = ""

    def enter(self) -> bool:
        """Registers a page. Returns False if too many pages are open or if the server is stopping."""
        with self._condition:
            if self._watchers >= MOST_WATCHERS or self._stop.is_set():
                return False
            self._watchers += 1
            if self._thread is None:
                self._thread = threading.Thread(target=self._look, daemon=True)
                self._thread.start()
            return True

    def leave(self) -> None:
        with self._condition:
            self._watchers -= 1

    def after(self, number: int) -> tuple[int, str]:
        """Waits for a text whose number is higher than `number`, and returns the new number and the text. If there is none within
        the time `KEEP_ALIVE`, returns the present number and text."""
        with self._condition:
            self._condition.wait_for(lambda: self.number > number or self._stop.is_set(), KEEP_ALIVE)
            return self.number, self.text

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def stop(self) -> None:
        self._stop.set()
        with self._condition:
            self._condition.notify_all()

    def refresh(self) -> None:
        """Observes the archive immediately, because an action may have changed it."""
        self._take(self._monitor.look())

    def _look(self) -> None:
        while not self._stop.is_set():
            self._take(self._monitor.look())
            self._stop.wait(EVERY)
            with self._condition:
                if not self._watchers:
                    self._thread = None
                    return

    def _take(self, activity: Activity) -> None:
        text = json.dumps(activity.to_json(), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
        with self._condition:
            if text != self.text:
                self.number, self.text = self.number + 1, text
                self._condition.notify_all()


class RefusedRequestError(Exception):
    """Reports that a request is refused. `status`: HTTP status of the reply. `message`: text of the reply."""

    def __init__(self, status: http.HTTPStatus, message: str):
        super().__init__(message)
        self.status, self.message = status, message


class LiveServer(ThreadingHTTPServer):
    """Serves the live page of an archive until `shutdown`. `port`: port number; 0 selects a free port. Raises `InputError` if the
    port is not available."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, monitor: Monitor, port: int = 0):
        self.monitor = monitor
        self.token = secrets.token_urlsafe(24)
        self.watching = _Watching(monitor)
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = error.strerror if isinstance(error, OSError) else str(error)
            raise InputError.at(
                Mark("--port"),
                "port-unavailable",
                f"port {port} of {LOOPBACK} is not available: {reason}",
                "choose another port, or `--port 0` for a free one",
            ) from None
        self.port: int = self.server_address[1]
        self.hosts = frozenset({f"{LOOPBACK}:{self.port}", f"localhost:{self.port}"})
        self.origins = frozenset(f"http://{host}" for host in self.hosts)

    @property
    def address(self) -> str:
        """Returns the address to open, with the token in its fragment."""
        return f"http://{LOOPBACK}:{self.port}/#{self.token}"

    def shutdown(self) -> None:
        self.watching.stop()
        super().shutdown()

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignores the errors that occur in a connection after its page was closed."""


class _Handler(BaseHTTPRequestHandler):
    server: LiveServer
    server_version = f"planrunner/{__version__}"
    sys_version = ""
    protocol_version = "HTTP/1.1"
    timeout = TIMEOUT

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def _answer(self, action: Callable[[], None]) -> None:
        try:
            if self.headers.get_all("Host") is None or self.headers.get_all("Host") != [self.headers["Host"]]:
                raise RefusedRequestError(http.HTTPStatus.BAD_REQUEST, "one Host is expected")
            if self.headers["Host"] not in self.server.hosts:
                raise RefusedRequestError(
                    http.HTTPStatus.MISDIRECTED_REQUEST, "this server is reached as 127.0.0.1 or localhost only"
                )
            origin = self.headers.get("Origin")
            if origin is not None and origin not in self.server.origins:
                raise RefusedRequestError(http.HTTPStatus.FORBIDDEN, "the request comes from another site")
            action()
        except RefusedRequestError as refusal:
            self.close_connection = True
            self._send(refusal.status, {"error": refusal.message})
        except InputError as error:
            self._send(http.HTTPStatus.CONFLICT, {"error": "; ".join(item.message for item in error.findings)})
        except (ConnectionError, TimeoutError):
            self.close_connection = True

    # -- reading -----------------------------------------------------------------------------------------------------

    def _get(self) -> None:
        file = FILES.get(self.path)
        if file is not None:
            name, kind = file
            self._send_bytes(http.HTTPStatus.OK, shipped_bytes("web", name), kind)
            return
        self._authorised()
        if self.path == "/api/activity":
            self._send(http.HTTPStatus.OK, self.server.monitor.look().to_json())
        elif self.path == "/api/events":
            self._events()
        else:
            raise RefusedRequestError(http.HTTPStatus.NOT_FOUND, "there is nothing at this address")

    def _events(self) -> None:
        """Sends the runs at present as server-sent events: immediately, and whenever they change."""
        watching = self.server.watching
        if not watching.enter():
            raise RefusedRequestError(
                http.HTTPStatus.SERVICE_UNAVAILABLE, f"{MOST_WATCHERS} pages are open already: close one of them"
            )
        try:
            self.close_connection = True
            self._begin(http.HTTPStatus.OK, "text/event-stream")
            self.end_headers()
            last = 0
            while not watching.stopped:
                number, text = watching.after(last)
                self.wfile.write(f"data: {text}\n\n".encode() if number > last else b": nothing new\n\n")
                last = number
        finally:
            watching.leave()

    # -- acting ------------------------------------------------------------------------------------------------------

    def _post(self) -> None:
        self._authorised()
        if self.headers.get("Origin") is None:
            raise RefusedRequestError(
                http.HTTPStatus.FORBIDDEN, "an action is accepted only from the live page, with its Origin"
            )
        body = self._body()
        monitor = self.server.monitor
        actions: Mapping[str, tuple[tuple[str, ...], Callable[..., None]]] = {
            "/api/pause": (("run",), monitor.pause),
            "/api/continue": (("run",), monitor.go_on),
            "/api/answer": (("run", "question", "by"), monitor.answer),
        }
        if self.path not in actions:
            raise RefusedRequestError(http.HTTPStatus.NOT_FOUND, "there is nothing at this address")
        names, act = actions[self.path]
        values = [body.get(name) for name in names]
        if set(body) != set(names) or not all(isinstance(value, str) for value in values):
            raise RefusedRequestError(http.HTTPStatus.BAD_REQUEST, f"give {', '.join(names)} as texts")
        act(*values)
        self.server.watching.refresh()
        self._send(http.HTTPStatus.OK, {"done": True})

    def _authorised(self) -> None:
        scheme, _, token = self.headers.get("Authorization", "").partition(" ")
        if scheme != "Bearer" or not hmac.compare_digest(token.encode("utf-8", "replace"), self.server.token.encode()):
            raise RefusedRequestError(
                http.HTTPStatus.UNAUTHORIZED, "open the page with the address that `planrunner serve` has printed"
            )

    def _body(self) -> JsonObject:
        if self.headers.get_content_type() != "application/json":
            raise RefusedRequestError(http.HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "the body must be application/json")
        try:
            length = int(self.headers.get("Content-Length", ""))
        except ValueError:
            raise RefusedRequestError(http.HTTPStatus.LENGTH_REQUIRED, "the length of the body is missing") from None
        if not 0 <= length <= MOST_BODY:
            raise RefusedRequestError(
                http.HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"the body may have at most {MOST_BODY} bytes"
            )
        try:
            body: Json = json.loads(self.rfile.read(length))
        except (ValueError, RecursionError):
            raise RefusedRequestError(http.HTTPStatus.BAD_REQUEST, "the body is not JSON") from None
        if not isinstance(body, dict):
            raise RefusedRequestError(http.HTTPStatus.BAD_REQUEST, "the body is not an object")
        return body

    # -- sending -----------------------------------------------------------------------------------------------------

    def _send(self, status: http.HTTPStatus, value: Json) -> None:
        self._send_bytes(status, json.dumps(value).encode(), "application/json")

    def _send_bytes(self, status: http.HTTPStatus, data: bytes, kind: str) -> None:
        self._begin(status, kind)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def _begin(self, status: http.HTTPStatus, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        if self.close_connection:
            self.send_header("Connection", "close")

    def log_message(self, format: str, *args: object) -> None:
        """Does nothing, because requests are not logged."""
