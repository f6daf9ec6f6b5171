"""Starts the watchdog process: `python -m planrunner.bench.watchdog_start`. From its first import on, it ignores the signals that
end planrunner."""

from planrunner.base.interruption import be_deaf

if __name__ == "__main__":
    be_deaf()
    from planrunner.bench.watchdog_process import live

    live()
