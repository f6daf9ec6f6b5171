"""Contains the functions that sensors on serial lines share: reading, streaming a segment, counting lost frames, and reporting
doubts.

The sensor's counter determines the times of the samples, which are converted to the bench's clock (`host_clock`). Lost frames
therefore appear as gaps in time. A driver adds its keys, its decoder and, if it configures the sensor, the commands for the
configuration.

After connecting, the first frames are checked: they must be valid, and must arrive at the rate that the bench file declares.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar, Generic, TypeVar

from planrunner.instruments.interfaces import (
    Block,
    Clock,
    Condition,
    FrameCounts,
    Hastens,
    InstrumentError,
    Surroundings,
)
from planrunner.instruments.models import SensorModel, rate_refused
from planrunner.instruments.sensors.keys import SerialSensorParameters, sensor_model
from planrunner.instruments.sensors.samples import Decoder
from planrunner.instruments.sensors.segment_stream import SegmentStream
from planrunner.instruments.wire.framing import Framer, Piece
from planrunner.instruments.wire.serial_stream import SerialStream
from planrunner.plan.schedule import Segment

TOLERANCE = math.log(1.4)
ENOUGH = 20
"""Minimum number of frames for a check of the rate."""
BACKLOG = 0.1
"""Time after the first bytes during which frames that waited in buffers may arrive, s."""


class FirstFrames:
    """Collects and checks the first frames after connecting.

    `seconds`: time between the first and the last valid frame; frames that waited in buffers do not count. `heard`: time of the
    last valid frame. `haste`: seconds of the bench's clock per second of real time. `haste` is necessary because buffers are filled
    and read in real time.
    """

    def __init__(self, decoder: Decoder, rate: float, haste: float = 1.0):
        self._decoder, self._rate, self._backlog = decoder, rate, BACKLOG * haste
        self._framer = Framer(decoder.framing)
        self._begun = self._first = self._last = self.heard = math.nan
        self._bytes = self._good = self._counted = 0

    @property
    def seconds(self) -> float:
        return self._last - self._first if self._counted else 0.0

    def push(self, pieces: Sequence[Piece]) -> None:
        self._bytes += sum(len(piece.data) for piece in pieces)
        received = self._decoder.decode(self._framer.push(pieces)).received
        if not received.size:
            return
        self._good += received.size
        self.heard = float(received[-1])
        self._begun = float(received[0]) if math.isnan(self._begun) else self._begun
        fresh = received[received > self._begun + self._backlog]
        if fresh.size:
            self._first = float(fresh[0]) if self._counted == 0 else self._first
            self._last = float(fresh[-1])
            self._counted += fresh.size

    def judge(self, port: str, baud: int) -> None:
        """Judges the first frames. Raises `InstrumentError` if no bytes have arrived, if they contain no frames, if the frames lack
        declared content, or if the rate differs from the declared rate."""
        if self._bytes == 0:
            raise InstrumentError(
                f"no data arrive from {port}: check that the sensor is switched on and connected to this port"
            )
        sync = self._decoder.framing.sync.hex(" ").upper()
        if self._framer.good == 0:
            raise InstrumentError(
                f"{self._bytes} bytes came from {port} at {baud} baud, but they contain no frame that begins with "
                f"{sync} and has a correct checksum: check `baud` and the sensor's output format"
            )
        if self._good == 0:
            wanted = ", ".join(self._decoder.channels())
            raise InstrumentError(
                f"the frames from {port} do not contain all of {wanted}: check the output format of the sensor"
            )
        if self._counted < ENOUGH or self.seconds == 0.0:
            return
        rate = (self._counted - 1) / self.seconds
        if abs(math.log(rate / self._rate)) > TOLERANCE:
            message = (
                f"about {rate:.4g} good frames per second arrive from {port}, but the bench file says {self._rate:g} Hz"
            )
            raise InstrumentError(f"{message}: correct `sample_rate`, the sensor's setting, or `baud`")


POLL = 0.05
"""Time between two blocks, s. This time is also the longest delay of a stop."""
LISTENING = 0.5
"""Duration of the frames that are used to check the rate after connecting, s."""
LISTENINGS = 3
"""Number of consecutive checks that must find a wrong rate before an error is reported."""
SKEW_TOLERANCE = 0.02

P = TypeVar("P", bound=SerialSensorParameters)


class SerialSensor(Generic[P]):
    """A sensor that streams frames. P is the record with the keys of the sensor. Derived drivers define `Parameters`,
    `manufacturer`, `product`, `model`, `decoder_of` and, if they configure the sensor, `configure`."""

    role = "sensor"
    manufacturer: ClassVar[str] = ""
    product: ClassVar[str] = ""

    def __init__(
        self,
        parameters: P,
        decoder: Decoder,
        link: SerialStream,
        clock: Clock,
        identity: Mapping[str, str] | None = None,
    ):
        self.parameters = parameters
        self.decoder = decoder
        self.link = link
        self.clock = clock
        self.identity = dict(identity or {})
        self._speed = clock.speed if isinstance(clock, Hastens) else 1.0  # of a simulated bench that hastens
        self._current: SegmentStream | None = None
        self._streaming = False
        self._skew = 0.0
        self._heard = clock.now()
        self._doubts: dict[str, None] = {}
        self._lasting = self.lasting_doubts(self.identity)

    @classmethod
    def decoder_of(cls, parameters: P) -> Decoder:
        """Makes the decoder for the frames of a sensor with these keys."""
        raise NotImplementedError

    @classmethod
    def configure(cls, parameters: P, link: SerialStream, clock: Clock) -> Mapping[str, str]:
        """Configures the sensor, if the driver supports this, and returns what the sensor reports about its identity. Raises
        `InstrumentError` if the sensor does not accept the configuration."""
        return {}

    @classmethod
    def lasting_doubts(cls, identity: Mapping[str, str]) -> tuple[str, ...]:
        """Returns doubts that concern all samples, such as a failed self-test. `identity`: the result of `configure`."""
        return ()

    @classmethod
    def model(cls, parameters: P) -> SensorModel:
        return sensor_model(parameters, cls.decoder_of(parameters).channels(), {})

    @classmethod
    def address(cls, parameters: P) -> str:
        return parameters.port

    @classmethod
    def connect(cls, parameters: P, surroundings: Surroundings) -> SerialSensor[P]:
        if not surroundings.real_time:
            raise InstrumentError("a sensor on a serial line works in real time: write `clock: wall` in the bench file")
        clock, decoder = surroundings.clock, cls.decoder_of(parameters)
        # Compiling takes seconds the first time, and no port waits so long.
        decoder.decode(Framer(decoder.framing).push([Piece(0.0, bytes(decoder.framing.longest))]))
        link = SerialStream.open(parameters.port, parameters.baud, clock.now)
        try:
            sensor = cls(parameters, decoder, link, clock, cls.configure(parameters, link, clock))
            sensor._listen()
        except BaseException:
            link.close()
            raise
        return sensor

    # -- capabilities --------------------------------------------------------------------------------------------------

    def channels(self) -> Mapping[str, str]:
        return self.decoder.channels()

    def foresee(self, segments: Sequence[Segment]) -> None:
        rate = self.parameters.sample_rate.value
        for segment in segments:
            if segment.dwell is None:
                raise InstrumentError(
                    f"'{segment.label}' has the dwell 'recorded', which is only possible with a recording"
                )
            if refused := rate_refused(segment.sample_rate, rate, one_rate=True):
                hint = "leave `sample_rate` out of the plan, or change the setting of the sensor"
                raise InstrumentError(f"'{segment.label}': {refused}: {hint}")

    def stream(self, segment: Segment) -> Iterator[Block]:
        """Yields the samples from now to the end of the segment's dwell."""
        self.foresee([segment])
        assert segment.dwell is not None
        self.link.ring.follow(True)
        self._streaming = True
        self._heard = start = self.clock.now()
        wanted = max(1, round(segment.dwell * self.parameters.sample_rate.value))
        current = SegmentStream(self.decoder, self.link, start, wanted, self._byte_time(), self._skew, self._speed)
        self._current = current
        advanced = start
        try:
            while not current.over:
                self.clock.sleep(POLL)
                block = current.advance()
                self._hear(current.heard, current.take_doubts())
                advanced = self.clock.now() if current.fresh or not current.heard else advanced
                self._check_count(self.clock.now() - advanced)
                self._check_skew(current.skew)
                yield block
            self._skew = current.skew
        finally:
            self._streaming = False
            self.link.ring.follow(False)

    def counts(self) -> FrameCounts:
        return FrameCounts() if self._current is None else self._current.counts()

    def watch(self) -> Condition:
        """Returns the doubts since the last query, and the lasting doubts. A fault is included if the sensor has been silent for
        too long."""
        if not self._streaming:
            self._overhear()
        doubts, self._doubts = (*self._lasting, *self._doubts), {}
        silent = self.clock.now() - self._heard
        faults = () if silent <= self._patience() else (self._silence(silent),)
        return Condition({}, faults, doubts)

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": self.manufacturer, "model": self.product, "port": self.parameters.port, **self.identity}

    def make_safe(self) -> None:
        """Does nothing, because a sensor that is only read is always safe."""

    def close(self) -> None:
        self.link.close()

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _patience(self) -> float:
        """Returns the longest permitted silence, in seconds of the bench's clock. The key in the bench file states this time in
        real time, because delays in cables and computers do not depend on the bench's clock."""
        return self.parameters.silence.value * self._speed

    def _byte_time(self) -> float:
        """Returns the time [s] per byte on the line, where a byte has ten bits; zero on a network."""
        return 0.0 if "://" in self.parameters.port else 10.0 / self.parameters.baud

    def _hear(self, frames: int, doubts: tuple[str, ...]) -> None:
        now = self.clock.now()
        self._doubts |= dict.fromkeys(doubts)
        if frames:
            self._heard = now
        elif now - self._heard > self._patience():
            raise InstrumentError(self._silence(now - self._heard))

    def _silence(self, seconds: float) -> str:
        return (
            f"the sensor on {self.parameters.port} has sent no good frame for {seconds:.1f} s: check its power and "
            f"its cable, and whether a reset changed its settings; then resume the run"
        )

    def _check_count(self, seconds: float) -> None:
        if seconds > self._patience():
            raise InstrumentError(
                f"the frames that came from {self.parameters.port} for {seconds:.1f} s have a constant counter: the sensor's counter is "
                "stuck, so the times of the samples are unknown; switch the sensor off and on, then resume the run"
            )

    def _check_skew(self, skew: float) -> None:
        if abs(skew) > SKEW_TOLERANCE:
            rate = self.parameters.sample_rate.value
            message = f"the sensor gives {rate / (1 + skew):.6g} frames per second, but the bench file says {rate:g} Hz"
            raise InstrumentError(f"{message}: correct `sample_rate`, or the sensor's setting")

    def _overhear(self) -> None:
        """Processes bytes that arrived while no segment was streamed. An incomplete first frame does not count as lost."""
        samples = self.decoder.decode(Framer(self.decoder.framing).push(self.link.take()))
        self._doubts |= dict.fromkeys(samples.doubts)
        if len(samples):
            self._heard = self.clock.now()

    def _listen(self) -> None:
        """Waits for valid frames that arrive at the declared rate. If there are none, raises `InstrumentError` with a description
        of what was received. A different rate is reported only if it is found repeatedly, because frames that waited during a pause
        of the computer arrive together."""
        self.link.ring.follow(True)
        try:
            for left in reversed(range(LISTENINGS)):
                first = self._heard_first()
                try:
                    first.judge(self.parameters.port, self.parameters.baud)
                except InstrumentError:
                    if not left or first.seconds == 0.0:
                        raise
                else:
                    break
        finally:
            self.link.ring.follow(False)
        silent = self.clock.now() - first.heard
        if silent > self._patience():
            raise InstrumentError(self._silence(silent))
        self._heard = self.clock.now()

    def _heard_first(self) -> FirstFrames:
        first = FirstFrames(self.decoder, self.parameters.sample_rate.value, self._speed)
        listening = LISTENING * self._speed
        end = self.clock.now() + self._patience() + listening
        while self.clock.now() < end and first.seconds < listening:
            self.clock.sleep(POLL)
            first.push(self.link.take())
        return first
