"""`python -m planrunner.bench.watchdog_start`: the watchdog process. It ignores the signals that end planrunner from its first import
on."""

from planrunner.base.interruption import be_deaf

if __name__ == "__main__":
    be_deaf()
    from planrunner.bench.watchdog_process import live

    live()
