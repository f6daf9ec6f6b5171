"""Renders a user's template in a child process. The process reads a request from standard input, limits its own resources, and
answers with JSON.

A thread limits the computing time, and finds which line of the template is being rendered. In addition, limits of the operating
system are set where they exist (Linux, partly macOS). These limits restrict time and memory, and prevent writing files and starting
processes. Windows has no such limits. There, the thread and the time-out of the parent process limit the time, and only the sandbox
limits what a template can do.
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

from planrunner.base.documents import JsonObject
from planrunner.reporting.sandbox import ReportError, lay_out
from planrunner.reporting.templates import from_json

CHECK_EVERY = 0.2  # s


def main() -> None:
    """Renders one template at the request of `planrunner.reporting.templates`."""
    request: JsonObject = json.loads(sys.stdin.buffer.read())
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
    """Sends the answer and ends the process at once, so that only the first answer counts."""
    _ANSWERING.acquire()
    sys.stdout.buffer.write(json.dumps(answer).encode())
    sys.stdout.flush()
    os._exit(0)


def _import_what_is_needed() -> None:
    """Imports the modules that rendering needs. The function is called before the limits are set, so that an import cannot exceed
    them."""
    import jinja2.ext
    import jinja2.sandbox
    import markupsafe

    del jinja2, markupsafe


def _limit(seconds: float, memory: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    processor = (
        int(time.process_time() + 2 * seconds) + 5
    )  # higher than the limit of the thread, which can report the line
    limits = {"RLIMIT_CPU": processor, "RLIMIT_AS": memory, "RLIMIT_FSIZE": 0, "RLIMIT_CORE": 0}
    for name, value in limits.items():
        with contextlib.suppress(AttributeError, ValueError, OSError):  # as far as the system supports and permits them
            resource.setrlimit(getattr(resource, name), (value, value))


def _watch(name: str, seconds: float) -> None:
    until = time.process_time() + seconds
    while time.process_time() < until:
        time.sleep(CHECK_EVERY)
    place = _place(sys._current_frames().get(threading.main_thread().ident or 0)) or name
    _answer({"error": f"{place}: the template takes more than {seconds:g} s of computing; check its loops"})


def _place(frame: FrameType | None) -> str | None:
    """Returns the position, as `template:line`, in the innermost template in the call stack of a frame; None if no template is in
    the call stack. The position is found in the same way as in jinja2.debug."""
    while frame is not None:
        template = frame.f_globals.get("__jinja_template__")
        if template is not None:
            line = template.get_corresponding_lineno(_line(frame))
            return f"{Path(frame.f_code.co_filename).name}:{line}"
        frame = frame.f_back
    return None


def _line(frame: FrameType) -> int:
    """Returns the number of the line that a frame executes at present. At the end of a loop, the instruction that jumps back to
    the start of the loop has no line number; the result is then the last line number before this instruction."""
    passed = [line for start, _, line in frame.f_code.co_lines() if line is not None and start <= frame.f_lasti]
    return passed[-1] if passed else frame.f_code.co_firstlineno


if __name__ == "__main__":
    main()
