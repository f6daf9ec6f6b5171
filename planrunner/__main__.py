"""Runs the command `planrunner`, also as `python -m planrunner`. The command handles signals before it imports anything slow."""

# Of `signal` the part that is built in: importing the rest takes milliseconds in which Ctrl-C would be a traceback.
import _signal  # type: ignore[import-not-found,unused-ignore]
import os
import sys


def main() -> int:
    """Runs the command of a process. Returns the exit code."""
    _end_at_once()
    from planrunner.base.interruption import Interruption, leave_with

    with Interruption() as interruption:
        try:
            from planrunner.cli import main as command

            code = command()
        except KeyboardInterrupt:
            code = interruption.tell()
        except Exception:  # what an interrupted import ends in
            if not interruption.reason:
                raise
            code = interruption.tell()
    leave_with(code)
    return code


def _end_at_once() -> None:
    """Ends the process at once on a signal that arrives before anything has begun."""
    for name in ("SIGINT", "SIGTERM"):
        number = getattr(_signal, name)
        if _signal.getsignal(number) != _signal.SIG_IGN:
            said = b"interrupted\n" if name == "SIGINT" else b"ended by SIGTERM\n"
            _signal.signal(number, lambda _number, _frame, said=said: _leave(said))


def _leave(said: bytes) -> None:
    try:
        os.write(2, said)
    finally:
        os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
