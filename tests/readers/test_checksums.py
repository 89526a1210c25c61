"""Checksums and ranges: a report identifies the bytes and the part of the log that were used."""

import gzip
import hashlib
import json
import os
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import imucal
from imucal.pipeline import Settings, characterize
from imucal.readers import checksums, read
from imucal.readers.checksums import checksums_of
from imucal.recording import LogFileInfo, Recording
from imucal.report import load_report
from imucal.report.json_file import schema
from tests.cli.run import run
from tests.readers.logs import START, imu_messages, samples, write_db3, write_mcap

#: A report as JSON on standard output, without other files.
QUICK = ("--model", "N", "--force", "-q", "--json", "--no-report")


def b2sum(path: Path) -> str:
    """Return the output of ``b2sum``."""
    return hashlib.blake2b(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("threads", ["1", "2"])
def test_every_file_has_its_size_and_checksum(
    threads: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cases: a file, all files in the folder of a bag, and several logs; with and without a thread."""
    monkeypatch.setenv("IMUCAL_THREADS", threads)
    one = write_mcap(tmp_path / "log_0.mcap", imu_messages(samples(300)))
    bag = write_db3(tmp_path / "bag", imu_messages(samples(300)))
    for path, files in ((one, [one]), (bag, sorted(bag.iterdir()))):
        found = read(path, checksums=True).source.files
        assert found == tuple(
            LogFileInfo(path=str(file), size_bytes=file.stat().st_size, blake2b=b2sum(file)) for file in files
        )
    assert read(one).source.files == ()


def test_the_checksum_has_the_published_value(tmp_path: Path) -> None:
    """RFC 7693, Appendix A, contains BLAKE2b-512 of the three bytes abc."""
    path = tmp_path / "abc.csv"
    path.write_bytes(b"abc")
    with checksums_of([path]) as files_of_log:
        (found,) = files_of_log()
    assert found.size_bytes == 3
    assert found.blake2b == (
        "ba80a53f981c4d0d6a2797b69f12f6e94c212f14685ac4b74b12bb6fdbffa2d1"
        "7d87c5392aab792dc252d5de4533cc9518d38aa8dbf1925ab92386edd4009923"
    )


def test_an_unreadable_file_has_no_checksum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cases: a deleted file, and standard input. An exception in the block stops the work."""
    with checksums_of([tmp_path / "gone.csv", Path("-")]) as files_of_log:
        assert files_of_log() == (LogFileInfo(path=str(tmp_path / "gone.csv"), size_bytes=0, blake2b=None),)
    path = tmp_path / "large.csv"
    path.write_bytes(bytes(1 << 16))
    monkeypatch.setattr(checksums, "_BLOCK", 16)
    with checksums_of([path]) as files_of_log:
        pass
    assert files_of_log() in ((), (LogFileInfo(path=str(path), size_bytes=1 << 16, blake2b=b2sum(path)),))


@pytest.mark.parametrize("packed", ["plain", "gzip", "cut", "zeros behind"])
def test_standard_input_has_size_and_checksum(packed: str, tmp_path: Path) -> None:
    """The checksum covers all bytes as received, compressed or not, even if reading ends early."""
    values = np.random.default_rng(5).normal(0, 1e-3, 3000).tolist()
    text = "\n".join(["t_s,gx_rads", *(f"{i / 100},{x!r}" for i, x in enumerate(values)), ""]).encode()
    compressed = gzip.compress(text)
    data = {
        "plain": text,
        "gzip": compressed,
        "cut": compressed[:-40],
        "zeros behind": compressed + bytes(99) + b"1",
    }[packed]
    done = run("fit", "-", *QUICK, cwd=tmp_path, text=data)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    jsonschema.validate(document, schema())
    expected = hashlib.blake2b(data).hexdigest()
    assert document["source"]["files"] == [
        {"path": "standard input", "size_bytes": len(data), "blake2b": expected, "etag": None}
    ]


def test_a_report_lists_the_files_read(tmp_path: Path) -> None:
    """The file has the checksum of `b2sum`; --skip and --take give the used part in s and as stamps."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(samples(3000)))
    done = run("fit", "log.mcap", "--skip", "5s", "--take", "20s", *QUICK, cwd=tmp_path)
    assert done.returncode == 0
    document = json.loads(done.stdout)
    jsonschema.validate(document, schema())
    assert document["source"]["files"] == [
        {"path": "log.mcap", "size_bytes": path.stat().st_size, "blake2b": b2sum(path), "etag": None}
    ]
    assert document["source"]["read"] == {
        "from_s": 5.0, "duration_s": 20.0, "start_ns": START + 5 * 10**9, "end_ns": START + 25 * 10**9,
    }  # fmt: skip
    (tmp_path / "report.json").write_text(done.stdout, encoding="utf-8")
    source = load_report(tmp_path).source
    assert source.files[0].blake2b == b2sum(path)
    assert source.read is not None
    assert (source.read.from_s, source.read.end_ns) == (5.0, START + 25 * 10**9)


def test_the_range_of_a_recording_is_reported(tmp_path: Path) -> None:
    """Cases: the complete recording, a part of a part, and a recording without stamps."""
    recording = read(write_mcap(tmp_path / "log.mcap", imu_messages(samples(3000))))
    settings = Settings(model="N", segments=1)
    report = characterize(recording, settings)
    assert report.source.read is not None
    assert (report.source.read.from_s, report.source.read.start_ns) == (0.0, START)
    assert report.source.read.duration_s == pytest.approx(30)
    part = recording.between(2, 25).between(3, 10)
    assert part.source.read is not None
    assert (part.source.read.from_s, part.source.read.start_ns) == (5.0, START + 5 * 10**9)
    assert part.source.read.duration_s == pytest.approx(7)
    series = imucal.AxisSeries.from_samples(recording.series[0].samples, rate_hz=100)
    plain = Recording(source=recording.source, series=(series,)).between(1, 3)
    assert plain.source.read is not None
    assert plain.source.read.from_s == 1.0
    assert plain.source.read.duration_s == pytest.approx(2.0)
    assert plain.source.read.start_ns is None


def test_a_pipe_has_no_checksum(tmp_path: Path) -> None:
    """Opening it would wait for a writer."""
    path = tmp_path / "log.csv"
    os.mkfifo(path)
    with checksums_of([path]) as files_of_log:
        assert files_of_log() == (LogFileInfo(path=str(path), size_bytes=0, blake2b=None),)
