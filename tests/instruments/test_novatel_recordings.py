"""Logs of raw IMU data of NovAtel receivers. The messages come from documents and programs of other people, so that their checksums
are not ours."""

from __future__ import annotations

import zlib
from pathlib import Path

import pytest

from planrunner.instruments.formats.choice import Format, open_file
from planrunner.instruments.formats.file import AnyFile, NoKeys, TimeStamps
from planrunner.instruments.formats.novatel import COLUMNS, is_raw_imu
from planrunner.instruments.interfaces import InstrumentError

SHORT = "%RAWIMUSA,1815,407772.000;1815,407771.985103333,00000077,63811,-6290,6253,7,-31,14*2d2a4cff"
EXTENDED = "%RAWIMUSXA,1692,484620.664;00,11,1692,484620.664389000,00801503,43110635,-817242,-202184,-215194,-41188,-9895*a5db8c7b"
OTHER = "%RAWIMUSA,1537,361705.645;1537,361705.644826900,00000000,30387,415,-5398,-23039,-18100736,-5117*c01b540c"


def opened(folder: Path, lines: list[str], *channels: str, time: str | None = None) -> AnyFile:
    (folder / "r.asc").write_text("\r\n".join(lines) + "\r\n", encoding="utf-8")
    stamps = TimeStamps(time, period=0.01)
    names = dict(zip(channels, channels, strict=True))
    return open_file(folder / "r.asc", "r.asc", stamps, names, Format(type="novatel", parameters=NoKeys()))


@pytest.mark.parametrize(
    ("line", "values"),
    [
        (SHORT, (1815 * 604800 + 407771.985103333, 0x77, 6253, 6290, 63811, 14, 31, 7)),
        (EXTENDED, (1692 * 604800 + 484620.664389, 0x801503, -202184, 817242, 43110635, -9895, 41188, -215194)),
        (OTHER, (1537 * 604800 + 361705.6448269, 0, -5398, -415, 30387, -5117, 18100736, -23039)),
    ],
)
def test_axes_are_ordered_and_y_has_its_sign(tmp_path: Path, line: str, values: tuple[float, ...]) -> None:
    """The message states the axes in the order z, -y, x."""
    file = opened(tmp_path, ["<OK", "#BESTPOSA,COM1,0;SOL*00000000", line], *COLUMNS)
    ((_, found),) = file.rows()
    assert [found[name].tolist() for name in COLUMNS] == [[pytest.approx(value, abs=1e-6)] for value in values]
    assert is_raw_imu((tmp_path / "r.asc").read_bytes())


def message(k: int, accel_z: int = 100) -> str:
    """A message of the long form, 10 ms after the one before; the second of the week returns to 0 at k = 50."""
    week, second = divmod(1815 * 604800 + 604799.5 + k / 100, 604800)
    body = f"RAWIMUA,COM1,0,68.5,FINESTEERING,{week:.0f},{second:.3f},024c0040,6125,30019;"
    body += f"{week:.0f},{second:.9f},00000077,{accel_z},-2,3,4,-5,{k}"
    crc = zlib.crc32(body.encode(), 0xFFFFFFFF) ^ 0xFFFFFFFF
    return f"#{body}*{crc:08x}"


def test_the_time_continues_over_the_end_of_the_week(tmp_path: Path) -> None:
    file = opened(tmp_path, [message(k) for k in range(100)], "gyro_x", time="time_s")
    file.look()
    ((time, found),) = file.rows()
    assert file.interval == pytest.approx(0.01, abs=1e-6)
    assert time[-1] - time[0] == pytest.approx(0.99, abs=2e-6)
    assert found["gyro_x"].tolist() == list(range(100))


def test_messages_with_a_wrong_checksum_are_left_out_and_counted(tmp_path: Path) -> None:
    lines = [message(k) for k in range(100)]
    lines[10] = lines[10].replace(";1815", ";1816")
    lines[20] = lines[20][:60]
    file = opened(tmp_path, lines, "gyro_x", time="time_s")
    file.look()
    ((_, found),) = file.rows()
    assert found["gyro_x"].tolist() == [k for k in range(100) if k not in (10, 20)]
    assert file.remarks == ("2 messages with a wrong checksum or form, the first in line 11",)
    for k in range(30, 50):
        lines[k] = lines[k].replace("FINE", "FINF")
    said = "r.asc: 22 of 100 messages have a wrong checksum or form, the first in line 11; check how the file was transferred"
    with pytest.raises(InstrumentError, match=said):
        opened(tmp_path, lines, "gyro_x", time="time_s").look()


def test_a_fault_is_named_with_its_line(tmp_path: Path) -> None:
    lines = ["<OK", *(message(k) for k in (0, 1, 2, 2, 3))]
    with pytest.raises(InstrumentError, match=r"r\.asc, row 4 \(line 5\): time does not increase"):
        opened(tmp_path, lines, "gyro_x", time="time_s").look()
    with pytest.raises(
        InstrumentError, match="has no column 'gx'; the columns of such a log are time_s, status, accel_x"
    ):
        opened(tmp_path, lines, "gx").look()
    with pytest.raises(InstrumentError, match="holds no samples"):
        opened(tmp_path, ["<OK", "x" * 5000], "gyro_x").look()
