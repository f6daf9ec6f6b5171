"""The recording player: what it serves, and what it says of recordings that are not as they should be."""

from __future__ import annotations

import itertools
import os
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planrunner.base.findings import Findings
from planrunner.bench.clock import VirtualClock
from planrunner.bench.model import read_bench
from planrunner.bench.opening import open_bench
from planrunner.instruments import recording_file
from planrunner.instruments.formats import file as format_file
from planrunner.instruments.interfaces import InstrumentError, Resumable, StreamsSamples, Surroundings
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_file import HeldRecording, at_hand
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.physics.earth import Site
from planrunner.plan import source
from planrunner.plan.kinds import RecordOf
from planrunner.plan.schedule import Rest, Segment
from planrunner.plan.span import Span

DATA = Path(os.environ.get("PLANRUNNER_DATA", Path(__file__).parents[3] / "shared" / "data"))
real_data = pytest.mark.skipif(
    not (DATA / "rimu_jig").is_dir(), reason="the real recordings are not there (PLANRUNNER_DATA)"
)

RATE = 10.0
TABLE = "label,start_s,end_s\nA,1.0,3.0\nB,4.0,9.0\n"


def parameters(**changes):
    keys = {
        "file": "r.parquet",
        "kind": "imu",
        "time": "{column: t, unit: s}",
        "channels": "{x: {column: x, unit: deg/s, noise: 0.2 deg/s}, y: {column: y, unit: g, sign: -1, full_scale: 2 "
        "g}}",
        "sample_rate": "10 Hz",
    } | changes
    log = Findings()
    text = "\n".join(f"{name}: {value}" for name, value in keys.items() if value is not None)
    made = RecordOf(RecordingParameters).read(source.parse(text, "bench.yaml"), log)
    assert list(log) == []
    return made


def write(folder: Path, name="r.parquet", t=None, x=None, group=30, **columns):
    t = np.arange(100) / RATE if t is None else np.asarray(t, dtype=float)
    x = np.arange(t.size, dtype=float) if x is None else x
    table = {"t": t, "x": x, "y": np.full(t.size, 0.5, dtype=np.float32), "other": np.zeros(t.size), **columns}
    if name.endswith(".csv"):
        lines = [",".join(table)]
        for row in zip(*table.values(), strict=True):
            lines.append(",".join("" if isinstance(v, float) and np.isnan(v) else repr(float(v)) for v in row))
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    else:
        pq.write_table(pa.table(table), folder / name, row_group_size=group)
    return folder


def player(root, **changes):
    surroundings = Surroundings(VirtualClock(), Site(0.7), data_root=root)
    return RecordingPlayer.connect(parameters(**changes), surroundings)


def play(instrument, label="A", dwell=None):
    blocks = list(instrument.stream(Segment(0, label, None, "unknown", Rest(), dwell)))
    time = np.concatenate([block.time for block in blocks])
    return time, {name: np.concatenate([b.channels[name] for b in blocks]) for name in instrument.channels()}


FORMATS = pytest.mark.parametrize("name", ["r.parquet", "r.csv"])


@FORMATS
def test_the_whole_recording_is_served_with_signs_and_time_from_its_first_row(tmp_path, name):
    write(tmp_path, name, t=500 + np.arange(100) / RATE)
    instrument = player(tmp_path, file=name)
    assert all(isinstance(instrument, able) for able in (StreamsSamples, Resumable))
    assert dict(instrument.channels()) == {"x": "deg/s", "y": "g"}
    time, data = play(instrument)
    assert time == pytest.approx(np.arange(100) / RATE)
    assert np.array_equal(data["x"], np.arange(100.0))
    assert np.array_equal(data["y"], np.full(100, -0.5))
    assert instrument.clock.now() == pytest.approx(10.0)


@FORMATS
@pytest.mark.parametrize(
    ("label", "dwell", "trim", "first", "last"),
    [("A", None, "0 s", 10, 29), ("B", None, "0.5 s", 45, 84), ("B", 1.0, "0 s", 40, 49), ("A", 2.0, "0 s", 10, 29)],
)
def test_a_segment_is_its_stretch_trimmed_and_cut_to_the_dwell(tmp_path, name, label, dwell, trim, first, last):
    write(tmp_path, name)
    (tmp_path / "s.csv").write_text(TABLE, encoding="utf-8")
    instrument = player(tmp_path, file=name, segments=f"{{table: s.csv, trim: {trim}}}")
    time, data = play(instrument, label, dwell)
    assert np.array_equal(data["x"], np.arange(first, last + 1, dtype=float))
    assert time[0] == pytest.approx(first / RATE)


@FORMATS
@pytest.mark.parametrize("most", [100, 99])
def test_a_recording_at_hand_serves_the_same_stretches(tmp_path, monkeypatch, name, most):
    monkeypatch.setattr(recording_file, "HELD", most)
    monkeypatch.setattr(format_file, "BATCH", 30)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    x = np.arange(100.0)
    x[7] = np.nan
    write(tmp_path, name, x=x, t=500 + np.arange(100) / RATE)
    file = player(tmp_path, file=name).file
    held = at_hand(file)
    assert isinstance(held, HeldRecording) == (most == 100)
    assert (held is file) == (most == 99 and name.endswith("parquet"))
    assert len(list(tmp_path.glob("planrunner-*"))) == int(most == 99 and name.endswith("csv"))
    assert (held.origin, held.interval) == (file.origin, file.interval)
    for start, end in (
        (-np.inf, np.inf),
        (500.7, 503.0),
        (501.0, 501.0),
        (499.0, 500.05),
        (509.9, 600.0),
        (600.0, 700.0),
    ):
        read = [list(one.rows(Span(start, end))) for one in (file, held)]
        whole = [[np.concatenate([np.empty(0), *[part(row) for row in rows]]) for part in PARTS] for rows in read]
        for one, other in zip(*whole, strict=True):
            assert np.array_equal(one, other, equal_nan=True)
    del held
    assert not list(tmp_path.glob("planrunner-*"))


PARTS = (lambda row: row[0], lambda row: row[1]["x"], lambda row: row[1]["y"])


def test_time_and_table_may_have_units_of_their_own(tmp_path):
    write(tmp_path, t=np.arange(100) * 100.0)
    (tmp_path / "s.csv").write_text("what;from\n", encoding="utf-8")
    (tmp_path / "s.csv").write_text("what,from,to\nA,0.05,0.1\n", encoding="utf-8")
    segments = "{table: s.csv, label: what, start: from, end: to, unit: min}"
    time, data = play(player(tmp_path, time="{column: t, unit: ms}", segments=segments))
    assert data["x"][[0, -1]].tolist() == [30.0, 59.0]
    assert time[0] == pytest.approx(3.0)


def test_the_model_is_known_without_the_file():
    model = RecordingPlayer.model(parameters(file="nowhere.parquet"))
    assert (model.kind, model.sample_rate) == ("imu", 10.0)
    x, y = model.output("x"), model.output("y")
    assert x is not None and y is not None
    assert y.full_scale == pytest.approx(2.0)
    assert x.noise.white == pytest.approx(0.2 / np.sqrt(10))


@FORMATS
def test_missing_numbers_are_passed_on_as_nan(tmp_path, name):
    x = np.arange(100.0)
    x[[3, 50]] = np.nan
    write(tmp_path, name, x=x)
    _, data = play(player(tmp_path, file=name))
    assert np.flatnonzero(np.isnan(data["x"])).tolist() == [3, 50]


def test_gaps_are_passed_on(tmp_path):
    t = np.arange(100) / RATE
    t[50:] += 3.0
    write(tmp_path, t=t)
    time, _ = play(player(tmp_path))
    assert np.diff(time).max() == pytest.approx(3.1)


@FORMATS
@pytest.mark.parametrize(
    ("row", "value", "words"),
    [
        (41, 3.9, r"row 42( \(line 43\))?: time does not increase: 3.9 s after 4 s"),
        (30, 2.9, r"row 31( \(line 32\))?: time does not increase: 2.9 s after 2.9 s"),
        (7, np.nan, r"row 8( \(line 9\))?: the time is missing"),
    ],
)
def test_time_that_does_not_increase_is_an_error_with_its_row(tmp_path, name, row, value, words):
    t = np.arange(100) / RATE
    t[row] = value
    write(tmp_path, name, t=t)
    with pytest.raises(InstrumentError, match=words):
        play(player(tmp_path, file=name))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"file": "r.parqet"}, "no file 'r.parqet' in the data folder"),
        ({"time": "{column: tt}"}, "no column 'tt'; did you mean 't'"),
        ({"channels": "{x: {column: X, unit: deg/s}}"}, "no column 'X'"),
        ({"file": "folder"}, "this is a folder"),
        ({"file": "notes.md"}, "state the format in the bench file"),
        ({"file": "broken.parquet"}, "broken.parquet cannot be read"),
        ({"file": "broken.csv"}, "broken.csv cannot be read"),
        ({"file": "blank.csv"}, "blank.csv cannot be read"),
        ({"file": "empty.parquet"}, "empty.parquet holds no samples"),
        ({"file": "empty.csv"}, "empty.csv holds no samples"),
        ({"segments": "{table: none.csv}"}, "no file 'none.csv'"),
    ],
)
def test_what_is_wrong_with_a_recording_is_said_before_anything_moves(tmp_path, changes, words):
    write(tmp_path)
    write(tmp_path, "empty.parquet", t=[])
    (tmp_path / "folder").mkdir()
    (tmp_path / "notes.md").write_text("t,x,y\n", encoding="utf-8")
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 no more")
    (tmp_path / "broken.csv").write_text("t,x,y\n0,1,2\n1,2\n", encoding="utf-8")
    (tmp_path / "blank.csv").write_bytes(b"")
    (tmp_path / "empty.csv").write_text("t,x,y\n", encoding="utf-8")
    with pytest.raises(InstrumentError, match=words):
        player(tmp_path, **changes)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("label,start_s\nA,1\n", "no column 'end_s'"),
        ("label,start_s,end_s\n", "contains no segments"),
        ("label,start_s,end_s\nA,1,2\nA,3,4\n", "line 3: the label 'A' appears twice"),
        ("label,start_s,end_s\nA,one,2\n", "line 2: 'one' in column 'start_s' is not a number"),
        ("label,start_s,end_s\nA,1\n", "line 2: '' in column 'end_s' is not a number"),
        ("label,start_s,end_s\nA,2,1\n", "line 2: the segment 'A' does not end after it starts"),
        ("label,start_s,end_s\nA,nan,1\n", "does not end after it starts"),
        ("label,start_s,end_s\n,1,2\n", "line 2: the label is empty"),
        ("label,start_s,end_s\nA,1,1.5\n", "lasts 0.5 s, and nothing remains after 0.25 s are trimmed from both ends"),
        ('label,start_s,end_s\n"A,1,2\n', "not readable as CSV"),
    ],
)
def test_what_is_wrong_with_a_segment_table_is_said(tmp_path, text, words):
    write(tmp_path)
    (tmp_path / "s.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InstrumentError, match=words):
        player(tmp_path, segments="{table: s.csv, trim: 0.25 s}")


@FORMATS
@pytest.mark.parametrize(
    ("label", "dwell", "words"),
    [
        ("C", None, "no segment 'C'"),
        ("A", 2.5, "shorter than the plan: 'A' dwells 2.5 s, but r.* holds only 2 s of it"),
        ("late", None, "no samples between 20 s and 21 s for 'late'"),
        ("end", 3.0, "shorter than the plan: 'end' dwells 3 s, but r.* holds only 1 s of it"),
    ],
)
def test_a_segment_that_the_recording_does_not_hold_is_an_error(tmp_path, name, label, dwell, words):
    write(tmp_path, name)
    (tmp_path / "s.csv").write_text(TABLE + "late,20,21\nend,9,12\n", encoding="utf-8")
    with pytest.raises(InstrumentError, match=words):
        play(player(tmp_path, file=name, segments="{table: s.csv}"), label, dwell)


def test_a_recording_shorter_than_a_single_dwell_is_an_error(tmp_path):
    write(tmp_path)
    assert play(player(tmp_path), dwell=10.0)[0].size == 100
    with pytest.raises(InstrumentError, match=r"dwells 11 s, but r.parquet holds only 10 s"):
        play(player(tmp_path), dwell=11.0)


def test_without_a_table_a_recording_is_one_segment(tmp_path):
    write(tmp_path)
    instrument = player(tmp_path)
    play(instrument, "first", 1.0)
    play(instrument, "first", 2.0)
    with pytest.raises(InstrumentError, match=r"played back as 'first'; 'second' needs `segments: \{table: …\}`"):
        play(instrument, "second")
    resumed = player(tmp_path)
    resumed.restore(instrument.checkpoint())
    with pytest.raises(InstrumentError, match="played back as 'first'"):
        play(resumed, "second")


def test_text_in_a_column_of_numbers_is_an_error(tmp_path):
    write(tmp_path, x=pa.array(["a"] * 100))
    with pytest.raises(InstrumentError, match="column 'x' holds text"):
        play(player(tmp_path))
    (tmp_path / "r.csv").write_text("t,x,y\n0,1,2\n0.1,one,2\n", encoding="utf-8")
    with pytest.raises(InstrumentError, match=r"r.csv, line 3: 'one' in column 'x' is not a number"):
        play(player(tmp_path, file="r.csv"))


@pytest.mark.parametrize(
    "name", ["../r.parquet", "a/../../r.parquet", "/etc/passwd", "C:\\r.parquet", "..\\r.parquet", "\\\\host\\r.csv"]
)
def test_paths_that_lead_outside_are_refused(tmp_path, name):
    root = tmp_path / "root"
    root.mkdir()
    write(tmp_path)
    with pytest.raises(InstrumentError, match="leads outside the data folder"):
        player(root, file=f"'{name}'")
    write(root)
    with pytest.raises(InstrumentError, match="leads outside the data folder"):
        player(root, segments="{table: '" + name + "'}")


def test_links_that_lead_outside_are_refused(tmp_path):
    root = tmp_path / "root"
    root.mkdir()
    write(tmp_path)
    try:
        (root / "r.parquet").symlink_to(tmp_path / "r.parquet")
        (root / "up").symlink_to(tmp_path, target_is_directory=True)
    except OSError:
        pytest.skip("this system does not let us make links")
    for name in ("r.parquet", "up/r.parquet"):
        with pytest.raises(InstrumentError, match="link that leads outside"):
            player(root, file=name)
    write(root, "own.parquet")
    (root / "within.parquet").symlink_to(root / "own.parquet")
    assert play(player(root, file="within.parquet"))[0].size == 100
    (root / "loop.parquet").symlink_to(root / "loop.parquet")
    with pytest.raises(InstrumentError, match="no file"):
        player(root, file="loop.parquet")


def test_without_a_data_root_it_says_what_to_give(tmp_path):
    with pytest.raises(InstrumentError, match="--data"):
        player(None)
    with pytest.raises(InstrumentError, match="check --data"):
        player(tmp_path / "nowhere")


def test_row_groups_outside_the_stretch_are_not_read(tmp_path, monkeypatch):
    write(tmp_path, t=np.arange(10_000) / RATE, group=1000)
    (tmp_path / "s.csv").write_text("label,start_s,end_s\nA,450,460\n", encoding="utf-8")
    instrument = player(tmp_path, segments="{table: s.csv}")
    rows = []
    original = instrument.file._check_time

    def counted(self, t, f, b):
        rows.append((f, t.size))
        return original(t, f, b)

    monkeypatch.setattr(type(instrument.file), "_check_time", counted)
    time, data = play(instrument)
    assert rows == [(4001, 1000)]
    assert data["x"][[0, -1]].tolist() == [4500.0, 4599.0]
    assert time[0] == pytest.approx(450.0)


@FORMATS
def test_blocks_stay_bounded(tmp_path, name):
    count = 200_000
    t = np.arange(count) / RATE
    if name.endswith(".csv"):
        np.savetxt(tmp_path / name, np.column_stack([t, t, t]), delimiter=",", header="t,x,y", comments="", fmt="%.1f")
    else:
        write(tmp_path, name, t=t, group=count)
    blocks = list(player(tmp_path, file=name).stream(Segment(0, "A", None, "", Rest(), None)))
    assert max(block.time.size for block in blocks) <= 65_536
    assert sum(block.time.size for block in blocks) == count


def test_in_real_time_it_plays_a_second_at_a_time(tmp_path):
    write(tmp_path)
    surroundings = Surroundings(VirtualClock(), Site(0.7), data_root=tmp_path, real_time=True)
    instrument = RecordingPlayer.connect(parameters(), surroundings)
    blocks = list(instrument.stream(Segment(0, "A", None, "", Rest(), 2.5)))
    assert [block.time.size for block in blocks] == [10, 10, 5]


@real_data
@pytest.mark.parametrize(
    ("name", "label", "channel", "expected"),
    [
        # README of the recordings: BNO reads 1.0028 times the rate; LSM 0.846 times it with a bias of −5.7 deg/s.
        ("rimu_rate_staircase", "R240", "bno_gyro_y", 240 * 1.0028),
        ("rimu_rate_staircase", "R240", "lsm_gyro_y", 240 * 0.846 - 5.7),
    ],
)
def test_real_rates_come_through(name, label, channel, expected):
    with open_bench(read_bench(name)[0], data_root=DATA) as bench:
        _, data = play(bench.sensor, label)
    assert data[channel].mean() == pytest.approx(expected, rel=0.01)


@real_data
@pytest.mark.parametrize("name", ["mpu9150_imu0", "mpu9150_imu2"])
def test_real_hand_tumbles_come_through(name):
    with open_bench(read_bench(name)[0], data_root=DATA) as bench:
        time, data = play(bench.sensor)
    assert time[-1] > 159
    size = np.sqrt(sum(data[f"accel_{axis}"] ** 2 for axis in "xyz"))
    assert np.median(size) == pytest.approx(9.8, abs=0.3)


@FORMATS
def test_neighbours_share_no_sample(tmp_path, name):
    """Time stamps in milliseconds, boundaries in decimal seconds, neither of which binary fractions hold exactly."""
    write(tmp_path, name, t=np.arange(100) * 100.1)
    edges = [0, 1.001, 2.002, 3.303, 7.007, 10.01]
    rows = [f"S{n},{a},{b}" for n, (a, b) in enumerate(itertools.pairwise(edges))]
    (tmp_path / "s.csv").write_text("\n".join(["label,start_s,end_s", *rows]), encoding="utf-8")
    instrument = player(tmp_path, file=name, time="{column: t, unit: ms}", segments="{table: s.csv}")
    played = [play(instrument, f"S{n}")[1]["x"] for n in range(5)]
    assert np.concatenate(played).tolist() == list(range(100))
    assert [part[0] for part in played] == [0, 10, 20, 33, 70]
