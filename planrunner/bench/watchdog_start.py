"""Starts the watchdog process: `python -m planrunner.bench.watchdog_start`. Before any longer import, the process begins to ignore
the signals that end planrunner."""

from planrunner.base.interruption import be_deaf

if __name__ == "__main__":
    be_deaf()
    from planrunner.bench.watchdog_process import live

    live()
