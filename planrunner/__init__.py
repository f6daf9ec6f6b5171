"""planrunner: declarative test plans for inertial sensors, checked, run, estimated and reported."""

__version__ = "0.1.0"
