"""Tests of memory and thread limits: settings, control groups and the machine."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from imucal import resources
from imucal.errors import SettingError
from imucal.resources import (
    control_group_limits,
    control_group_processors,
    limit_pools,
    memory_limit,
    threads,
)
from tests.cli.run import run
from tests.readers.logs import imu_messages, samples, write_mcap


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("1000", 1000),
        ("2K", 2048),
        ("500M", 500 << 20),
        ("1.5G", 3 << 29),
        ("2 GiB", 2 << 30),
        ("1gb", 1 << 30),
    ],
)
def test_the_memory_setting_has_priority(text: str, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMUCAL_MEMORY", text)
    assert memory_limit() == size


@pytest.mark.parametrize("text", ["lots", "-1", "0", "0.1", "1 X", "G"])
def test_an_invalid_memory_setting_is_rejected(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error contains the value and an example."""
    monkeypatch.setenv("IMUCAL_MEMORY", text)
    with pytest.raises(SettingError, match="IMUCAL_MEMORY: found "):
        memory_limit()


def test_the_default_is_a_quarter_of_the_smallest_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits are those of the machine and the control groups; unknown ones are ignored."""
    monkeypatch.delenv("IMUCAL_MEMORY", raising=False)
    for physical, groups, limit in (
        (16 << 30, [], 4 << 30),
        (16 << 30, [2 << 30, 8 << 30], 512 << 20),
        (1 << 30, [1 << 62], 256 << 20),
        (None, [400], 100),
        (None, [], 2_000_000_000),
    ):
        monkeypatch.setattr(resources, "_physical", lambda value=physical: value)
        monkeypatch.setattr(resources, "control_group_limits", lambda value=groups: value)
        resources.memory_there_is.cache_clear()
        assert memory_limit() == limit
    resources.memory_there_is.cache_clear()


@pytest.mark.parametrize(
    ("line", "file", "limits"),
    [
        ("0::/job/a", "job/a/memory.max", [1000]),
        ("0::/job/a", "job/memory.max", [1000]),
        ("0::/", "memory.max", [1000]),
        ("4:memory:/job/a", "job/a/memory.max", []),
        ("0::/job/b", "job/a/memory.max", []),
    ],
)
def test_the_limits_of_control_groups_are_read(
    line: str, file: str, limits: list[int], tmp_path: Path
) -> None:
    """Limits of parent groups count."""
    (tmp_path / "cgroup").write_text(f"9:name=systemd:/\n{line}\n", encoding="utf-8")
    limit = tmp_path / "root" / file
    limit.parent.mkdir(parents=True, exist_ok=True)
    limit.write_text("1000\n", encoding="utf-8")
    assert control_group_limits(tmp_path / "cgroup", tmp_path / "root") == limits
    limit.write_text("max\n", encoding="utf-8")
    assert control_group_limits(tmp_path / "cgroup", tmp_path / "root") == []
    assert control_group_limits(tmp_path / "none", tmp_path / "root") == []


@pytest.mark.parametrize(
    ("line", "files", "processors"),
    [
        ("0::/job/a", {"job/a/cpu.max": "150000 100000"}, [2]),
        ("0::/job/a", {"job/a/cpu.max": "max 100000", "job/cpu.max": "100000 100000"}, [1]),
        ("0::/job/a", {"job/a/cpu.max": "max 100000"}, []),
        ("0::/job/a", {"job/cpu.max": "350000 100000"}, [4]),
        ("3:cpu,cpuacct:/job/a", {"job/a/cpu.max": "350000 100000"}, []),
        ("0::/job/a", {}, []),
    ],
)
def test_the_processors_of_control_groups_are_read(
    line: str, files: dict[str, str], processors: list[int], tmp_path: Path
) -> None:
    """They are the quota per period, rounded up; parent groups count."""
    (tmp_path / "cgroup").write_text(f"9:name=systemd:/\n{line}\n", encoding="utf-8")
    for name, text in files.items():
        (tmp_path / "root" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "root" / name).write_text(f"{text}\n", encoding="utf-8")
    assert control_group_processors(tmp_path / "cgroup", tmp_path / "root") == processors
    assert control_group_processors(tmp_path / "none", tmp_path / "root") == []


def test_a_container_has_fewer_threads_than_its_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The smaller one of available processors and quota counts."""
    monkeypatch.delenv("IMUCAL_THREADS", raising=False)
    monkeypatch.setattr(os, "process_cpu_count", lambda: 8, raising=False)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    for groups, count in (([], 8), ([3], 3), ([16, 2], 2)):
        monkeypatch.setattr(resources, "control_group_processors", lambda value=groups: value)
        assert threads() == count


def test_the_thread_setting_has_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """The default is the number of processors of this process."""
    monkeypatch.setenv("IMUCAL_THREADS", "3")
    assert threads() == 3
    monkeypatch.delenv("IMUCAL_THREADS")
    assert 1 <= threads() <= (os.cpu_count() or 1)
    for text in ("0", "-1", "two", "1.5", "²"):
        monkeypatch.setenv("IMUCAL_THREADS", text)
        with pytest.raises(SettingError, match="IMUCAL_THREADS: found "):
            threads()


def test_the_thread_setting_applies_to_libraries(monkeypatch: pytest.MonkeyPatch) -> None:
    """A library's own variable has priority, and an invalid number changes nothing."""
    for name in ("POLARS_MAX_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    monkeypatch.setenv("IMUCAL_THREADS", "no")
    limit_pools()
    assert "POLARS_MAX_THREADS" not in os.environ
    monkeypatch.setenv("IMUCAL_THREADS", "2")
    limit_pools()
    assert (os.environ["POLARS_MAX_THREADS"], os.environ["OPENBLAS_NUM_THREADS"]) == ("2", "7")
    for name in ("POLARS_MAX_THREADS", "OMP_NUM_THREADS", "RAYON_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)


def test_polars_respects_the_thread_setting(tmp_path: Path) -> None:
    """Polars reads its limit when it is imported, which is after this package."""
    code = "import imucal, polars; print(polars.thread_pool_size())"
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")}
    done = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-c", code],
        env={**clean, "IMUCAL_THREADS": "1"}, cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == "1"


@pytest.mark.parametrize(("there", "threads_of_matrices"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_matrix_products_of_a_command_use_one_thread(
    there: dict[str, str], threads_of_matrices: str, tmp_path: Path
) -> None:
    """The variable is set before the import of NumPy, unless the user has set it."""
    code = (
        "import sys, os; from imucal.cli import main; assert 'numpy' not in sys.modules\n"
        "try: main(['--version'])\n"
        "except SystemExit: print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    clean = {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")}
    done = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-c", code],
        env={**clean, **there}, cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split()[-1] == threads_of_matrices


def test_a_log_is_decoded_by_the_set_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One thread is the caller's; an invalid number exits with 2."""
    path = write_mcap(tmp_path / "log.mcap", imu_messages(samples(600)))
    started: list[int] = []
    pool = ThreadPoolExecutor

    def counted(number: int) -> object:
        started.append(number)
        return pool(number)

    monkeypatch.setattr("imucal.readers.messages.loader.ThreadPoolExecutor", counted)
    for number, pools in (("1", set()), ("2", {2})):
        started.clear()
        assert run("adev", str(path), "-q", cwd=tmp_path, IMUCAL_THREADS=number).returncode == 0
        assert set(started) == pools
    done = run("adev", str(path), cwd=tmp_path, IMUCAL_THREADS="many")
    assert (done.returncode, done.stderr.partition(":")[0]) == (2, "Error")
    done = run("fit", str(path), cwd=tmp_path, IMUCAL_MEMORY="much")
    assert done.returncode == 2
