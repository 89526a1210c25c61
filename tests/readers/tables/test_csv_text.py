"""Compression, encodings, line ends and damage do not change the numbers of a text table."""

import bz2
import gzip
import io
import lzma
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import numpy.testing as npt
import pytest
import zstandard

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError, DataError, ReadError
from imucal.readers import description
from imucal.readers.formats import describe_log as describe
from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read
from imucal.readers.tables import text_source
from imucal.recording import Recording
from tests.raising import raises
from tests.readers.tables.texts import N, lines, seconds, truth, xyz

HEADER = "time (s),gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s),acc_x (m/s^2),acc_y (m/s^2),acc_z (m/s^2)"


def plain() -> str:
    """Return a table in SI units with even stamps."""
    return lines(HEADER, seconds(truth()), *xyz(truth().gyro), *xyz(truth().accel))


def store(folder: Path, content: str | bytes, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def table(recording: Recording) -> FloatArray:
    return np.stack([series.samples for series in recording.series], axis=1)


def expected() -> FloatArray:
    return np.hstack([truth().gyro, truth().accel])


def codes(recording: Recording) -> list[str]:
    return [finding.code for finding in recording.findings]


def xz(data: bytes) -> bytes:
    return lzma.compress(data)


def zstd(data: bytes) -> bytes:
    return zstandard.compress(data)


def lz4_frame(data: bytes) -> bytes:
    compressed: bytes = lz4.frame.compress(data)
    return compressed


@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress, xz, zstd, lz4_frame])
def test_compression_is_detected_by_the_first_bytes(
    compress: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    npt.assert_array_equal(
        table(read(store(tmp_path, compress(plain().encode())), ReadOptions())), expected()
    )


def test_all_members_of_gzip_and_all_frames_of_zstd_are_read(tmp_path: Path) -> None:
    """Logs that were compressed piece by piece consist of several members."""
    first, second = plain().encode()[:20_000], plain().encode()[20_000:]
    for compress in (gzip.compress, zstd):
        path = store(tmp_path, compress(first) + compress(second))
        npt.assert_array_equal(table(read(path, ReadOptions())), expected())


@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress, xz, zstd, lz4_frame])
def test_a_cut_compressed_file_gives_its_complete_rows(
    compress: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    """If nothing can be unpacked, the error reports that."""
    samples = np.random.default_rng(1).normal(size=(6, 10 * N)) + np.array([[0, 0, 0, 0, 0, 9.8]]).T
    content = lines(
        HEADER, [f"{i * 0.01:.2f}" for i in range(10 * N)], *[[repr(float(v)) for v in x] for x in samples]
    )
    data = compress(content.encode())
    path = store(tmp_path, data[: len(data) * 9 // 10])
    try:
        recording = read(path, ReadOptions())
    except ReadError as error:
        # bzip2 unpacks a block completely or not at all.
        assert compress is bz2.compress
        assert "The bzip2 stream is cut off or damaged" in str(error)  # noqa: PT017
    else:
        assert codes(recording)[0] == "truncated"
        n = recording.series[0].n
        assert 5 * N < n < 10 * N
        npt.assert_array_equal(table(recording), samples.T[:n])


def test_the_path_minus_reads_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    """The input may be compressed."""

    class Standard:
        buffer = io.BytesIO(gzip.compress(plain().encode()))

    monkeypatch.setattr("sys.stdin", Standard())
    recording = read(Path("-"), ReadOptions())
    npt.assert_array_equal(table(recording), expected())
    assert recording.source.path == "standard input"


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_a_text_cut_within_a_character_loses_its_last_line(encoding: str, tmp_path: Path) -> None:
    path, rows = tmp_path / "log.csv", [f"{i * 10},0.0{i % 3},0.02,0.03" for i in range(50)]
    text = "\n".join(["time_ms,gx_rad/s,gy_rad/s,gz_rad/s", *rows]) + "\n"
    path.write_bytes(text.encode(encoding)[:-11])
    recording = read(path, ReadOptions())
    assert recording.series[0].n == 49
    assert [finding.code for finding in recording.findings] == ["cut-line"]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
def test_encodings_do_not_change_the_numbers(encoding: str, tmp_path: Path) -> None:
    """Cases: a byte order mark, two bytes per character, and a superscript of Latin-1."""
    content = plain().replace("m/s^2", "m/s²").encode(encoding)
    npt.assert_array_equal(table(read(store(tmp_path, content), ReadOptions())), expected())


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_do_not_change_the_numbers(end: str, tmp_path: Path) -> None:
    """Cases: Unix, Windows and old Macintosh."""
    npt.assert_array_equal(
        table(read(store(tmp_path, plain().replace("\n", end)), ReadOptions())), expected()
    )


@pytest.mark.parametrize("size", [1 << 10, 4321, 1 << 16])
def test_the_block_size_does_not_change_the_numbers(
    size: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_source, "_HEAD", 600)
    monkeypatch.setattr(text_source, "_BLOCK", size)
    for content in (plain(), plain().replace("\n", "\r\n"), plain().replace("\n", "\n\n")):
        recording = read(store(tmp_path, content), ReadOptions())
        npt.assert_array_equal(table(recording), expected())
        assert codes(recording) == []


def test_numbers_equal_those_of_python_float(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = [
        [
            f"{v:.{int(d)}{kind}}"
            for v, d, kind in zip(
                rng.normal(size=N) * 10.0**p, rng.integers(1, 18, N), "gef" * N, strict=False
            )
        ]
        for p in range(-3, 3)
    ]
    recording = read(store(tmp_path, lines(HEADER, seconds(truth()), *values)), ReadOptions())
    npt.assert_array_equal(
        table(recording), np.array([[float(cell) for cell in column] for column in values]).T
    )


def test_integer_stamps_stay_integers(tmp_path: Path) -> None:
    """Nanoseconds since 1970 do not fit in a double; a jitter of 1 ns must be visible."""
    rng = np.random.default_rng(4)
    jitter = rng.integers(-40, 40, N)
    stamps = [1_700_000_000_000_000_001 + i * 10_000_000 + int(jitter[i]) for i in range(N)]
    content = lines(HEADER.replace("(s)", "[ns]", 1), stamps, *xyz(truth().gyro), *xyz(truth().accel))
    clock = read(store(tmp_path, content), ReadOptions()).series[0].clock
    assert clock.start_ns is not None
    assert abs(clock.start_ns - stamps[0]) < 100
    assert clock.jitter_s == pytest.approx(np.std(jitter) * 1e-9, rel=0.1)


def test_stamps_damaged_by_a_spreadsheet_are_refused(tmp_path: Path) -> None:
    """The spreadsheet wrote 1.40E+18 in every row."""
    content = lines(
        HEADER.replace("(s)", "[ns]", 1), ["1.40E+18"] * N, *xyz(truth().gyro), *xyz(truth().accel)
    )
    with raises(DataError, "do not increase", place="log.csv", argument="rate_hz"):
        read(store(tmp_path, content), ReadOptions())


def test_a_cut_last_line_is_dropped_with_a_note(tmp_path: Path) -> None:
    """A last line without a line end may contain a cut number."""
    content = plain().rstrip("\n")[:-3]
    recording = read(store(tmp_path, content), ReadOptions())
    npt.assert_array_equal(table(recording), expected()[:-1])
    (finding,) = recording.findings
    assert (finding.code, finding.level) == ("cut-line", "info")
    assert finding.text.startswith("The last line has no line end and may be cut off ('3.990000,")


def test_a_complete_last_line_without_line_end_is_kept(tmp_path: Path) -> None:
    """A fixed number of decimals shows that the last number is complete."""
    fixed = [
        [f"{float(cell):.6f}" for cell in column] for column in (*xyz(truth().gyro), *xyz(truth().accel))
    ]
    recording = read(store(tmp_path, lines(HEADER, seconds(truth()), *fixed).rstrip("\n")), ReadOptions())
    assert recording.series[0].n == N
    assert codes(recording) == []


@pytest.mark.parametrize(
    "bad",
    [
        "1.0,2.0",
        "1.0,oops,1,1,1,1,1",
        "1,1,1,1,1,1,1,1,1",
        "\x00" * 40,
        "0x10,0x10,0x10,0x10,0x10,0x10,0x10",
        "1_0,1_0,1_0,1_0,1_0,1_0,1_0",
        ",,,,,,",
        '"1.0,2,3,4,5,6,7',
    ],
)
def test_bad_rows_are_counted_and_dropped(bad: str, tmp_path: Path) -> None:
    """The finding reports their number; the other rows stay exact."""
    rows = plain().split("\n")
    rows.insert(201, bad)
    rows.insert(301, bad)
    recording = read(store(tmp_path, "\n".join(rows)), ReadOptions())
    npt.assert_array_equal(table(recording), expected())
    (finding,) = recording.findings
    assert (finding.code, finding.level) == ("bad-rows", "warning")
    assert finding.text.startswith("2 of 402 rows are not 7 numbers; the first is ")


def test_strict_refuses_bad_rows(tmp_path: Path) -> None:
    rows = plain().split("\n")
    rows.insert(201, "1.0,oops,1,1,1,1,1")
    path = store(tmp_path, "\n".join(rows))
    with pytest.raises(ReadError) as caught:
        read(path, ReadOptions(strict=True))
    assert str(caught.value) == (
        f"{path}: 1 of 401 rows are not 7 numbers; the first is '1.0,oops,1,1,1,1,1'; "
        "expected a table with a row per sample"
    )


def test_strict_refuses_a_cut_end(tmp_path: Path) -> None:
    path = store(tmp_path, plain().rstrip("\n")[:-3])
    with raises(ReadError, "the last line has no line end", place="log.csv"):
        read(path, ReadOptions(strict=True))
    path = store(tmp_path, gzip.compress(plain().encode())[:-100])
    with raises(ReadError, "The gzip stream is cut off", place="log.csv"):
        read(path, ReadOptions(strict=True))


def test_comments_blank_lines_and_a_repeated_header_are_ignored(tmp_path: Path) -> None:
    """A logger that was started twice repeats its header."""
    rows = plain().split("\n")
    rows[150:150] = ["", "# paused", "// resumed", HEADER, ""]
    recording = read(store(tmp_path, "\n".join(rows)), ReadOptions())
    npt.assert_array_equal(table(recording), expected())
    assert codes(recording) == []


def test_nan_and_infinity_are_kept(tmp_path: Path) -> None:
    columns = [*xyz(truth().gyro), *xyz(truth().accel)]
    columns[1][7], columns[4][9] = "nan", "-inf"
    recording = read(store(tmp_path, lines(HEADER, seconds(truth()), *columns)), ReadOptions())
    assert np.isnan(recording.axis("gyroscope", "y").samples[7])
    assert recording.axis("accelerometer", "y").samples[9] == -np.inf
    assert recording.series[0].n == N


def test_a_column_can_change_from_integers_to_decimals(tmp_path: Path) -> None:
    """The times in ms are integers only in the first rows."""
    now = [str(i * 10) if i < 350 else f"{i * 10}.5" for i in range(N)]
    content = lines(HEADER.replace("(s)", "(ms)", 1), now, *xyz(truth().gyro), *xyz(truth().accel))
    recording = read(store(tmp_path, content), ReadOptions())
    assert recording.series[0].n == N
    assert recording.series[0].rate_hz == pytest.approx(100, rel=1e-4)


def test_quoted_cells_can_contain_delimiters(tmp_path: Path) -> None:
    """The quoted column is not read."""
    content = lines(
        f"note,{HEADER}", ['"a, b"'] * N, seconds(truth()), *xyz(truth().gyro), *xyz(truth().accel)
    )
    npt.assert_array_equal(table(read(store(tmp_path, content), ReadOptions())), expected())


def test_progress_increases_to_the_file_size(tmp_path: Path) -> None:
    """Each progress call gets the number of bytes read and the total."""
    calls: list[tuple[int, int]] = []
    path = store(tmp_path, plain())
    read(path, ReadOptions(progress=lambda done, size: calls.append((done, size))))
    size = path.stat().st_size
    assert calls[-1] == (size, size)
    assert calls == sorted(calls)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty; expected a log"),
        (b"\n\n \n", "the text is empty; expected a table of numbers"),
        (
            b"a,b" + bytes(range(1, 9)) * 400 + b"\n",
            "binary data, not text; expected a table of numbers, or another format",
        ),
        (
            b"hello\nworld\nagain\n",
            ("found no rows of numbers; the first line is 'hello'; expected a table with a row per sample"),
        ),
        (
            b"gx,gy,gz\n" + b"1,2,3,4\n" * 20,
            (
                "the header has 3 names and the rows 4 cells; found columns: "
                "0 = 1, 1 = 2, 2 = 3, 3 = 4; name them in a columns text of the form "
                "t=TIME,g=X+Y+Z,a=X+Y+Z (names of columns, or their numbers from 0)"
            ),
        ),
    ],
)
def test_a_file_that_is_not_a_table_is_refused(content: bytes, message: str, tmp_path: Path) -> None:
    """The error reports the content and explains the solution."""
    path = store(tmp_path, content)
    with pytest.raises(ReadError) as caught:
        read(path, ReadOptions())
    assert str(caught.value) == f"{path}: {message}"


def test_a_missing_file_is_a_read_error(tmp_path: Path) -> None:
    with raises(ReadError, "No such file or directory", place="none.csv"):
        read(tmp_path / "none.csv", ReadOptions())


def test_a_line_of_megabytes_is_refused(tmp_path: Path) -> None:
    """A line of that size is no row and must not fill the memory."""
    content = plain().encode() + b"1" * (12 << 20)
    with raises(ReadError, "more than 1048576 bytes", place="log.csv"):
        read(store(tmp_path, content), ReadOptions())


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_the_first_rows_describe_a_large_file(
    pack: Callable[[bytes], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first rows give columns, units and rate; the number of rows stays unknown."""
    monkeypatch.setattr(description, "_SMALL", 1000)
    monkeypatch.setattr(text_source, "_HEAD", 4096)
    contents = describe(store(tmp_path, pack(plain().encode())), ReadOptions())
    (topic,) = contents.topics
    assert topic.rate_hz == pytest.approx(100)
    assert (topic.count, topic.duration_s, len(topic.sensors)) == (None, None, 2)
    assert "gyroscope unit rad/s, from the column header" in topic.note


def test_an_ambiguous_table_is_described_with_the_reason(tmp_path: Path) -> None:
    """An ambiguous table has columns that can be listed; a file that is no table is an error."""
    content = lines("time (s),x,y,z", seconds(truth()), *xyz(truth().gyro))
    (topic,) = describe(store(tmp_path, content), ReadOptions()).topics
    assert topic.sensors == ()
    assert topic.note.startswith(
        "x, y and z (x, y, z) have no sensor in their names; found columns: 0 time (s)"
    )
    with raises(ReadError, "no rows of numbers", place="log.csv"):
        describe(store(tmp_path, "hello\nworld\n\n"), ReadOptions())


def test_topics_of_a_table_are_refused(tmp_path: Path) -> None:
    """A table has no topics, so the option must not be ignored."""
    path = store(tmp_path, plain())
    with pytest.raises(ChoiceError) as caught:
        read(path, ReadOptions(topics=("/imu",)))
    text = "a table has no topics such as /imu; expected no topic, or a columns text"
    assert str(caught.value) == f"{path}: {text}"


@pytest.mark.parametrize("compress", [bz2.compress, xz, zstd, lz4_frame])
def test_a_damaged_compressed_file_is_read_up_to_the_damage(
    compress: Callable[[bytes], bytes], tmp_path: Path
) -> None:
    """Each package raises different errors. If nothing was unpacked, the file is refused."""
    path = tmp_path / "log.csv"
    text_source = "t,gyro_x,gyro_y,gyro_z\n" + "".join(f"{i / 100},0.{i:05},0.2,0.3\n" for i in range(20_000))
    data = bytearray(compress(text_source.encode()))
    for place in range(len(data) // 2, len(data) - 20, 97):
        data[place] ^= 0x55
    path.write_bytes(data)
    try:
        recording = read(path, ReadOptions(gyro_unit="rad/s"))
    except ReadError as error:
        assert "stream is cut off or damaged" in str(error)  # noqa: PT017 - reading may also succeed
    else:
        assert recording.series[0].n < 20_000
        assert "truncated" in codes(recording)
