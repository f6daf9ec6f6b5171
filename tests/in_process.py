"""`planrunner` called in this process: as a user calls it, but without the second that a process of its own takes to start.

For tests of what commands do. What is tested of the process itself (signals, encodings, broken pipes, kills) starts one.
"""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path
from unittest import mock


def planrunner(*arguments: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Exit code and output of a command in a folder, with these environment variables beside the present ones."""
    from planrunner.cli import main

    words = [str(argument) for argument in arguments]
    output, errors = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    with contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.dict(os.environ, environment))
        stack.enter_context(mock.patch.object(sys, "stdin", stack.enter_context(open(os.devnull, encoding="utf-8"))))
        stack.enter_context(mock.patch.object(sys, "argv", ["planrunner", *words]))
        stack.enter_context(contextlib.chdir(cwd))
        stack.enter_context(contextlib.redirect_stdout(output))
        stack.enter_context(contextlib.redirect_stderr(errors))
        code = main(words)
    said, warned = (stream.buffer.getvalue().decode("utf-8") for stream in (output, errors))
    return subprocess.CompletedProcess(["planrunner", *words], code, said, warned)
