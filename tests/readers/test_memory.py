"""Logs that do not fit into memory: a part can be read, and the error says so."""

from pathlib import Path

import numpy as np
import pytest

from imucal.errors import DataError
from imucal.readers import message_logs, read
from tests.cli.run import run
from tests.raising import raises
from tests.readers.logs import CONTAINERS, samples

#: 40 s at 100 Hz: 8 columns of 8 bytes and the log time need 288 kB.
TRUTH = samples(4000)


@pytest.fixture
def small_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the machine have 150 kB, of which columns may take 90 kB, and read 1 s around a part."""
    monkeypatch.setattr("imucal.readers.memory.memory_there_is", lambda: 150_000)
    monkeypatch.setattr(message_logs, "_MARGIN_S", 1.0)


@pytest.mark.parametrize("name", ["mcap-zstd", "bag-lz4", "db3", "db3-message", "rosbag2-mcap"])
def test_a_part_of_a_log_that_does_not_fit_into_memory_is_read(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The samples and their times are those of the same part of the whole recording."""
    path = CONTAINERS[name](tmp_path, TRUTH)
    expected = read(path, skip_s=15.0, take_s=5.0)
    monkeypatch.setattr("imucal.readers.memory.memory_there_is", lambda: 150_000)
    monkeypatch.setattr(message_logs, "_MARGIN_S", 1.0)
    found = read(path, skip_s=15.0, take_s=5.0)
    assert found.source.read == expected.source.read
    for number, (one, other) in enumerate(zip(found.series, expected.series, strict=True)):
        np.testing.assert_array_equal(one.samples, TRUTH.all[1500:2000, number])
        np.testing.assert_array_equal(one.samples, other.samples)
        assert one.clock.start_ns == other.clock.start_ns == TRUTH.stamps[1500]


@pytest.mark.usefixtures("small_machine")
def test_a_log_that_does_not_fit_into_memory_is_refused_with_the_option_that_helps(tmp_path: Path) -> None:
    path = CONTAINERS["mcap-zstd"](tmp_path, TRUTH)
    with raises(DataError, "need 0.000288 GB of memory, and this machine has 0.00015 GB", argument="take_s"):
        read(path)
    with raises(DataError, "need 0.000288 GB of memory", argument="take_s"):
        read(path, take_s=39.0)
    done = run("adev", str(path), "-q", cwd=tmp_path)
    assert done.returncode == 4
    assert "Use --take TIME or --skip TIME." in done.stderr
    assert run("adev", str(path), "-q", "--take", "5s", cwd=tmp_path).returncode == 0


@pytest.mark.usefixtures("small_machine")
@pytest.mark.parametrize("name", ["log.csv", "log.npz", "log.npy"])
def test_a_table_that_does_not_fit_into_memory_is_refused(name: str, tmp_path: Path) -> None:
    """The size of a text is estimated by the length of its first lines."""
    path = tmp_path / name
    if name == "log.npz":
        np.savez(path, gyro=TRUTH.gyro, accel=TRUTH.accel)
    elif name == "log.npy":
        np.save(path, TRUTH.all)
    else:
        rows = [f"{time * 0.01},{','.join(map(repr, row))}" for time, row in enumerate(TRUTH.all.tolist())]
        text = "\n".join(["t_s,gx_rads,gy_rads,gz_rads,ax_ms2,ay_ms2,az_ms2", *rows, ""])
        path.write_text(text, encoding="utf-8")
    with raises(DataError, "GB of memory, and this machine has 0.00015 GB", place=name):
        read(path)
