"""The faults of the campaign, one row each: what goes wrong, when, and how it must end."""

from __future__ import annotations

from dataclasses import dataclass

START, TURNING, WARMING, MOVING = "start", "turning", "warming", "moving"
"""Before planrunner is started; while the second segment turns; while the chamber heats for the third; while the first is approached."""


@dataclass(frozen=True)
class Row:
    """fault: as the control channel takes it, or what is done to a process or the computer. ends: exit code, negative for a signal.
    says: what the message must hold. not_safe: instruments that nobody can reach then, which must be told of; kept: segments that must be
    acknowledged by then; clears: seconds of the wall after which the fault is over by itself."""

    name: str
    fault: str
    when: str
    ends: int
    says: str = ""
    not_safe: tuple[str, ...] = ()
    notices: str = ""

    @property
    def kept(self) -> int:
        if self.ends == 0:
            return 3
        return {START: 0, MOVING: 0, TURNING: 1, WARMING: 2}[self.when]


def _of(instrument: str, fault: str, **more: object) -> str:
    told = "".join(f", {key}: {value}" for key, value in more.items())
    return f"{{instrument: {instrument}, fault: {fault}{told}}}"


ROWS = (
    # connecting
    Row("table refuses at first", _of("table", "refuse"), START, 3, "table (acutrol) cannot be connected"),
    Row("chamber refuses at first", _of("chamber", "refuse"), START, 3, "refuses the connection"),
    Row("another table answers", _of("table", "wrong model"), START, 3, "Somebody Else"),
    Row("another chamber answers", _of("chamber", "wrong model"), START, 3, "Somebody Else"),
    Row("table is silent at first", _of("table", "silent"), START, 3, "did not answer"),
    Row("line is silent at first", _of("gyro", "silent"), START, 3, "no data arrive from"),
    Row("line at another baud", _of("gyro", "wrong baud"), START, 3, "baud"),
    Row("another sensor on the line", _of("gyro", "wrong model"), START, 3, "no frame that begins with"),
    Row("self-test failed at first", _of("gyro", "self-test"), START, 3, "(status: self-test failed)"),
    # what is said
    Row(
        "table's link drops once",
        _of("table", "drop link", count=1, message="':read:pos'"),
        TURNING,
        0,
        notices="sent again",
    ),
    Row("table's link drops in a command", _of("table", "drop link", count=1, message="':demand:rate'"), START, 0),
    Row("chamber's link drops once", _of("chamber", "drop link", count=1), TURNING, 0, notices="sent again"),
    Row(
        "table answers late once",
        _of("table", "late", delay="3 s", count=1, message="read"),
        TURNING,
        0,
        notices="sent again",
    ),
    Row("chamber answers late once", _of("chamber", "late", delay="3 s", count=1), TURNING, 0, notices="sent again"),
    Row("table always answers late", _of("table", "late", delay="6 s"), TURNING, 3, "did not answer", ("table",)),
    Row("table answers half once", _of("table", "partial", count=1), TURNING, 0, notices="sent again"),
    Row("table answers half for good", _of("table", "partial"), TURNING, 3, "in the middle of its answer", ("table",)),
    Row("chamber answers half once", _of("chamber", "partial", count=1), TURNING, 0, notices="sent again"),
    Row("table answers garbage once", _of("table", "garbage", count=1), TURNING, 0, notices="sent again"),
    Row("chamber answers garbage once", _of("chamber", "garbage", count=1), TURNING, 0, notices="sent again"),
    Row("chamber answers garbage for good", _of("chamber", "garbage"), TURNING, 3, "not text", ("chamber",)),
    Row("chamber falls silent", _of("chamber", "silent"), TURNING, 3, "did not answer", ("chamber",)),
    Row("table falls silent", _of("table", "silent"), TURNING, 3, "did not answer", ("table",)),
    Row("table's port closes", _of("table", "refuse"), TURNING, 3, "NOT IN THE SAFE STATE: table", ("table",)),
    Row("chamber's port closes", _of("chamber", "refuse"), WARMING, 3, "NOT IN THE SAFE STATE: chamber", ("chamber",)),
    # what is done
    Row("axis fault", _of("table", "axis fault", axis=1), TURNING, 3, "'table' cannot continue"),
    Row("over-rate trip", _of("table", "over-rate", axis=1), TURNING, 3, "'table' cannot continue"),
    Row("tracking error", _of("table", "tracking error", axis=2), TURNING, 3, "'table' cannot continue"),
    Row("interlock opens", _of("table", "interlock open"), TURNING, 3, "interlock"),
    Row("interlock opens for a while", _of("table", "interlock open", **{"for": "20 s"}), TURNING, 3, "interlock"),
    Row("chamber stuck for a while", _of("chamber", "stuck", **{"for": "30 s"}), MOVING, 0),
    Row("chamber stuck for good", _of("chamber", "stuck"), WARMING, 3, "the chamber does not reach 28.0 degC"),
    Row("chamber alarms", _of("chamber", "alarm"), WARMING, 3, "cannot continue"),
    Row("chamber overshoots", _of("chamber", "overshoot", overshoot="20 K"), WARMING, 3, "hotter than"),
    # frames
    Row("1 % corrupt", _of("gyro", "corrupt", share="1 %"), TURNING, 0),
    Row("half corrupt", _of("gyro", "corrupt", share="50 %"), TURNING, 3, "frames were"),
    Row("all corrupt", _of("gyro", "corrupt"), TURNING, 3, "no good frame"),
    Row("5 % lost", _of("gyro", "lose", share="5 %"), TURNING, 0),
    Row("10 % twice", _of("gyro", "duplicate", share="10 %"), TURNING, 0),
    Row("5 % out of order", _of("gyro", "reorder", share="5 %"), TURNING, 0),
    Row("another baud", _of("gyro", "wrong baud"), TURNING, 3, "no good frame"),
    Row("silent for a moment", _of("gyro", "silent", **{"for": "2 s"}), TURNING, 0),
    Row("silent for good", _of("gyro", "silent"), TURNING, 3, "no good frame"),
    Row("unplugged", _of("gyro", "unplug"), TURNING, 3, "gyro"),
    Row("unplugged and back", _of("gyro", "unplug", **{"for": "10 s"}), TURNING, 3, "gyro"),
    Row("another instrument on the line", _of("gyro", "wrong model"), TURNING, 3, "no good frame"),
    Row("overload", _of("gyro", "overload"), TURNING, 3, "marks its samples as doubtful (status: overload)"),
    Row("overload for a while", _of("gyro", "overload", **{"for": "30 s"}), TURNING, 3, "(status: overload)"),
    # processes and the computer
    Row("killed while turning", "SIGKILL", TURNING, -9),
    Row("killed on a ramp", "SIGKILL", WARMING, -9),
    Row("killed while it moves", "SIGKILL", MOVING, -9),
    Row("terminated", "SIGTERM", TURNING, 130, "Stopped at once"),
    Row("stands still", "SIGSTOP", TURNING, -9, "no sign of life for 15 s"),
    Row("watchdog killed", "SIGKILL watchdog", TURNING, 3, "watchdog process has ended"),
    Row("simulated bench killed", "SIGKILL simulator", TURNING, 3, "NOT IN THE SAFE STATE", ("table", "chamber")),
    Row("disk full", "disk full", TURNING, 3, "No space left on device"),
    Row("clock set back", "clock step", TURNING, 0),
    Row("clock set on", "clock leap", TURNING, 0),
)
SAMPLE = (
    "killed while turning",
    "table answers late once",
    "table always answers late",
    "table's port closes",
    "axis fault",
    "chamber overshoots",
    "half corrupt",
    "unplugged and back",
    "disk full",
)
"""What continuous integration runs; `make faults` runs all."""
OF_SENSORS = {
    "stim300": (
        Row("overload", _of("gyro", "overload"), TURNING, 3, "(gyro: overload)"),
        Row("self-test", _of("gyro", "self-test"), START, 3, "(gyro: system integrity error)"),
    ),
    "kvh_1775": (
        Row("overload", _of("gyro", "overload"), TURNING, 3, "(gyro: x invalid)"),
        Row("self-test", _of("gyro", "self-test"), START, 3, "(gyro: x invalid)"),
    ),
    "xsens_mti": (
        Row("overload", _of("gyro", "overload"), TURNING, 3, "(MTi: gyro x clipped)"),
        Row("self-test", _of("gyro", "self-test"), START, 3, "(MTi: self-test failed)"),
    ),
    "vectornav": (Row("half corrupt", _of("gyro", "corrupt", share="50 %"), TURNING, 3, "frames were"),),
}
"""What the status of each kind of sensor says, on a bench with such a one, and one fault of frames where it has no status; for all of them
besides: """
OF_EVERY_SENSOR = (
    Row("another sensor at first", _of("gyro", "wrong model"), START, 3, "no frame that begins with"),
    Row("unplugged and back", _of("gyro", "unplug", **{"for": "10 s"}), TURNING, 3, "gyro"),
    Row("5 % lost", _of("gyro", "lose", share="5 %"), TURNING, 0),
)
