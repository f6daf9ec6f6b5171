"""Declares the bench-file keys of the virtual platform."""

from __future__ import annotations

from planrunner.instruments.parameters import QuantityLike
from planrunner.plan.kinds import Choice, Kind, ListOf, Number, QuantityOf, Record, RecordOf, key, optional
from planrunner.plan.quantity import Quantity, parse_quantity


def _each(kind: Kind, description: str, example: str, default: str) -> Quantity:
    declared: Quantity = key(kind, description, example, default=parse_quantity(default))
    return declared


class Rates(Record):
    """Declares the bench-file keys for a rate about each axis of the stabilised element."""

    x: Quantity = _each(QuantityOf("angular rate"), "About x.", "0.3 deg/h", "0 deg/h")
    y: Quantity = _each(QuantityOf("angular rate"), "About y.", "-0.2 deg/h", "0 deg/h")
    z: Quantity = _each(QuantityOf("angular rate"), "About z.", "0.1 deg/h", "0 deg/h")


class DriftByRocking(Record):
    """Declares the bench-file keys for the drift that rocking causes. This drift is proportional to the square of the base's
    angular rate."""

    rms_rate: Quantity = key(
        QuantityOf("angular rate", "positive"),
        "Root mean square angular rate of the base, of all rings together, at which the drift is stated.",
        "4.62 deg/s",
    )
    x: Quantity = _each(QuantityOf("angular rate"), "Drift about x at that rate.", "0.01 deg/h", "0 deg/h")
    y: Quantity = _each(QuantityOf("angular rate"), "Drift about y at that rate.", "-0.01 deg/h", "0 deg/h")
    z: Quantity = _each(QuantityOf("angular rate"), "Drift about z at that rate.", "0.01 deg/h", "0 deg/h")


class Caging(Record):
    """Declares the bench-file keys for the errors after caging and release."""

    dead_region: Quantity = _each(
        QuantityOf("angle", "not negative"),
        "Half-width of the dead zone of the levelling loops; caging leaves the element anywhere within it.",
        "1 arcmin",
        "0 arcmin",
    )
    azimuth: Quantity = _each(
        QuantityOf("angle", "not negative"),
        "Standard deviation of the azimuth, drawn at each caging.",
        "1 arcmin",
        "0 arcmin",
    )
    leaving: Quantity = _each(
        QuantityOf("angle", "not negative"),
        "Standard deviation, about each axis, of the angle by which the element turns while it leaves the dead zone.",
        "20 arcsec",
        "0 arcsec",
    )
    leaving_time: Quantity = _each(QuantityOf("time", "positive"), "Time constant of this turn.", "12 s", "12 s")
    duration: Quantity = _each(QuantityOf("time", "not negative"), "Duration of caging.", "20 s", "20 s")


class InstallationAngles(Record):
    """Declares the bench-file keys for the rotation of each accelerometer's input axis about the other two axes, right-handed; xz
    is the rotation of the x accelerometer about z."""

    xz: Quantity = _each(QuantityOf("angle"), "x accelerometer about z.", "12 arcsec", "0 arcsec")
    xy: Quantity = _each(QuantityOf("angle"), "x accelerometer about y.", "-8 arcsec", "0 arcsec")
    yz: Quantity = _each(QuantityOf("angle"), "y accelerometer about z.", "5 arcsec", "0 arcsec")
    yx: Quantity = _each(QuantityOf("angle"), "y accelerometer about x.", "9 arcsec", "0 arcsec")
    zy: Quantity = _each(QuantityOf("angle"), "z accelerometer about y.", "-3 arcsec", "0 arcsec")
    zx: Quantity = _each(QuantityOf("angle"), "z accelerometer about x.", "14 arcsec", "0 arcsec")


class QuartzAccelerometers(Record):
    """Declares the bench-file keys of the three quartz accelerometers on the stabilised element."""

    range: str = key(Choice(("1.25 g", "20 g")), "Range of the current converter.", "1.25 g", default="1.25 g")
    bits: int = key(
        Number(8, 32, integer=True),
        "Number of bits of the converter over the whole range, both signs together.",
        21,
        default=21,
    )
    bias: Quantity = _each(
        QuantityOf("acceleration", "not negative"),
        "Standard deviation of the bias of each accelerometer.",
        "50 ug",
        "0 ug",
    )
    bias_walk: Quantity = _each(
        QuantityLike("ug/sqrt(h)", "not negative"), "Random walk of each bias.", "10 ug/sqrt(h)", "0 ug/sqrt(h)"
    )
    white_noise: Quantity = _each(
        QuantityLike("ug*sqrt(s)", "not negative"),
        "Random-walk coefficient N: the mean over T seconds scatters by N/√T.",
        "5 ug*sqrt(s)",
        "0 ug*sqrt(s)",
    )
    installation: InstallationAngles = key(
        RecordOf(InstallationAngles),
        "Angles of the accelerometers' input axes relative to the element's axes.",
        {"xz": "12 arcsec"},
        default_factory=InstallationAngles,
    )


class GimbalEncoders(Record):
    """Declares the bench-file keys of the multi-speed resolvers on the gimbals."""

    resolution: Quantity = _each(
        QuantityOf("angle", "not negative"), "Smallest step; 0 for no quantisation.", "1 arcsec", "0 arcsec"
    )
    error: Quantity = _each(
        QuantityOf("angle", "not negative"), "Amplitude of the periodic error.", "4 arcsec", "0 arcsec"
    )
    speeds: int = key(Number(1, 1024, integer=True), "Periods of this error per turn.", 32, default=32)


class TableEncoders(Record):
    """Declares the bench-file keys of the ring encoders of the rocking table, and of the encoders' errors. The encoders are
    recorded with the platform."""

    resolution: Quantity = _each(
        QuantityOf("angle", "not negative"), "Smallest step; 0 for no quantisation.", "0.4 arcsec", "0 arcsec"
    )
    return_error: Quantity = _each(
        QuantityOf("angle", "not negative"),
        "Standard deviation of the error of a ring's reading after it comes to rest, drawn each time.",
        "15 arcsec",
        "0 arcsec",
    )
    lag: Quantity = _each(QuantityOf("time", "not negative"), "Delay of the reading of a moving ring.", "1 ms", "0 s")
    wander: Quantity = _each(
        QuantityLike("arcsec/sqrt(h)", "not negative"),
        "Random walk of a ring relative to its reading.",
        "5 arcsec/sqrt(h)",
        "0 arcsec/sqrt(h)",
    )


class VirtualPlatformParameters(Record):
    """Declares the bench-file keys of a simulated gimballed platform on the virtual table, whose true parameters are known."""

    drift: Rates = key(
        RecordOf(Rates), "Constant drift of the stabilised element.", {"x": "0.3 deg/h"}, default_factory=Rates
    )
    drift_repeatability: Quantity = _each(
        QuantityOf("angular rate", "not negative"),
        "Standard deviation, about each axis, of the drift from one release to the next.",
        "0.002 deg/h",
        "0 deg/h",
    )
    random_walk: Quantity = _each(
        QuantityLike("deg/sqrt(h)", "not negative"),
        "Random walk of the attitude of the element.",
        "0.0004 deg/sqrt(h)",
        "0 deg/sqrt(h)",
    )
    rocking_drift: DriftByRocking | None = optional(
        RecordOf(DriftByRocking), "Drift while the base rocks.", {"rms_rate": "4.62 deg/s", "x": "0.01 deg/h"}
    )
    caging: Caging = key(
        RecordOf(Caging), "Caging and release of the element.", {"azimuth": "1 arcmin"}, default_factory=Caging
    )
    accelerometers: QuartzAccelerometers = key(
        RecordOf(QuartzAccelerometers), "The accelerometers.", {"range": "1.25 g"}, default_factory=QuartzAccelerometers
    )
    gimbal_encoders: GimbalEncoders = key(
        RecordOf(GimbalEncoders), "The gimbals' encoders.", {"resolution": "1 arcsec"}, default_factory=GimbalEncoders
    )
    table_encoders: TableEncoders = key(
        RecordOf(TableEncoders),
        "The table's ring encoders.",
        {"return_error": "15 arcsec"},
        default_factory=TableEncoders,
    )
    rings: int = key(
        Number(1, 3, integer=True), "Number of rings of the table that carries the platform.", 3, default=3
    )
    lever_arm: tuple[Quantity, ...] = key(
        ListOf(QuantityOf("length"), minimum=3, maximum=3),
        "Position of the accelerometers relative to the centre of the rings, along the base's x, y and z.",
        ["30 mm", "-20 mm", "50 mm"],
        default_factory=tuple,
    )
    sample_rate: Quantity = key(QuantityOf("frequency", "positive"), "Samples per second.", "100 Hz")
