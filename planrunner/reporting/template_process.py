"""The child process in which a user's template is laid out: reads a request from standard input, limits itself, answers with JSON.

Computing time is watched by a thread, which knows the line that the template is at; the system's own limits, where it has them (Linux, and
in part macOS), stand behind it: on time, on memory, and on writing files or starting processes at all. Windows has none of these: there
the watching thread and the parent's patience bound the time, and the sandbox alone what a template may hold.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
from pathlib import Path
from types import FrameType
from typing import Any

from planrunner.reporting.sandbox import ReportError, lay_out
from planrunner.reporting.template_data import from_json

CHECK_EVERY = 0.2  # s


def main() -> None:
    """Lay out one template as `planrunner.reporting.templates` asks for."""
    request: dict[str, Any] = json.loads(sys.stdin.buffer.read())
    _import_what_is_needed()
    _limit(request["seconds"], request["memory"])
    threading.Thread(target=_watch, args=(request["name"], request["seconds"]), daemon=True).start()
    try:
        page = lay_out(request["name"], from_json(request["given"]), Path(request["folder"]), request["most"])
        answer = {"page": page}
    except ReportError as error:
        answer = {"error": str(error)}
    _answer(answer)


_ANSWERING = threading.Lock()


def _answer(answer: dict[str, str]) -> None:
    """The first answer is the only one; the process ends with it, without waiting for anything."""
    _ANSWERING.acquire()
    sys.stdout.buffer.write(json.dumps(answer).encode())
    sys.stdout.flush()
    os._exit(0)


def _import_what_is_needed() -> None:
    """Before the limits hold, so that a report that comes close to them is not ended by an import."""
    import jinja2.ext
    import jinja2.sandbox
    import markupsafe

    del jinja2, markupsafe


def _limit(seconds: float, memory: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    processor = int(time.process_time() + 2 * seconds) + 5  # the watching thread, which knows the line, comes first
    limits = {"RLIMIT_CPU": processor, "RLIMIT_AS": memory, "RLIMIT_FSIZE": 0, "RLIMIT_CORE": 0}
    for name, value in limits.items():
        with contextlib.suppress(AttributeError, ValueError, OSError):  # as far as the system has them and lets us
            resource.setrlimit(getattr(resource, name), (value, value))


def _watch(name: str, seconds: float) -> None:
    until = time.process_time() + seconds
    while time.process_time() < until:
        time.sleep(CHECK_EVERY)
    place = _place(sys._current_frames().get(threading.main_thread().ident or 0)) or name
    _answer({"error": f"{place}: the template takes more than {seconds:g} s of computing; check its loops"})


def _place(frame: FrameType | None) -> str | None:
    """`template:line` of the innermost template that a frame belongs to, as jinja2.debug finds it."""
    while frame is not None:
        template = frame.f_globals.get("__jinja_template__")
        if template is not None:
            line = template.get_corresponding_lineno(_line(frame))
            return f"{Path(frame.f_code.co_filename).name}:{line}"
        frame = frame.f_back
    return None


def _line(frame: FrameType) -> int:
    """The line that a frame is at, or came from: the jump at the end of a loop belongs to none."""
    passed = [line for start, _, line in frame.f_code.co_lines() if line is not None and start <= frame.f_lasti]
    return passed[-1] if passed else frame.f_code.co_firstlineno


if __name__ == "__main__":
    main()
