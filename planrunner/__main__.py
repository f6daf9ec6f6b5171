"""`python -m planrunner`, and the command `planrunner`: signals are listened to before the rest is imported."""

import sys

from planrunner.interruption import Interruption, leave_to_the_system


def main() -> int:
    """The command of a process. Returns the exit code."""
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
    leave_to_the_system()
    return code


if __name__ == "__main__":
    sys.exit(main())
