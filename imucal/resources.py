"""Limits of memory and threads: from the machine, its container, or environment variables.

``IMUCAL_MEMORY`` limits the memory of one step (``500M``, ``2G``), ``IMUCAL_THREADS`` the number of threads,
including library threads.
"""

import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path, PurePosixPath

from imucal.errors import Fix, SettingError
from imucal.user_input import bytes_of

#: Environment variable with the limit of the memory.
MEMORY = "IMUCAL_MEMORY"
#: Environment variable with the number of threads.
THREADS = "IMUCAL_THREADS"

#: Memory of one step, in bytes, if the machine's memory is unknown.
_UNKNOWN = 2_000_000_000
#: Default limit of samples in memory, in bytes.
_COLUMNS = 500_000_000
#: One step may use the memory divided by this.
_SHARE = 4
#: Read by the matrix libraries when they are loaded, and by all libraries.
MATRICES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
POOLS = ("POLARS_MAX_THREADS", "RAYON_NUM_THREADS", "OMP_NUM_THREADS", *MATRICES)


def memory_limit() -> int:
    """Return the memory of one step in bytes: ``IMUCAL_MEMORY``, or a quarter of the available memory.

    Raises SettingError if ``IMUCAL_MEMORY`` is not a size.
    """
    size = size_setting(MEMORY)
    if size is not None:
        return size
    there_is = memory_there_is()
    return there_is // _SHARE if there_is else _UNKNOWN


def size_setting(name: str, *, least: int = 1) -> int | None:
    """Return the size in an environment variable, such as ``500M``, in bytes; None if it is not set.

    Raises SettingError if it is not a size, or less than `least`.
    """
    text = os.environ.get(name, "").strip()
    if not text:
        return None
    try:
        return bytes_of(text, least=least)
    except ValueError as error:
        problem = f"found {text!r}, expected {error}"
        raise SettingError(problem, place=name, fix=Fix("set one, or unset it")) from error


@cache
def memory_there_is() -> int | None:
    """Return the memory of the machine in bytes, or the smaller limit of its control group.

    It is found once, because reading the limits takes 1 ms and each topic of a log asks.
    """
    return min((size for size in (_physical(), *control_group_limits()) if size), default=None)


def column_limit() -> int:
    """Return the limit of samples in memory, in bytes; the rest goes to a temporary file.

    It is ``IMUCAL_MEMORY`` if set, otherwise 500 MB or the memory of one step, whichever is less. Raises
    SettingError if ``IMUCAL_MEMORY`` is not a size.
    """
    limit = memory_limit()
    return limit if os.environ.get(MEMORY, "").strip() else min(limit, _COLUMNS)


def threads() -> int:
    """Return the number of threads: ``IMUCAL_THREADS``, or the processors that this process may use.

    Raises SettingError if ``IMUCAL_THREADS`` is not a positive integer.
    """
    text = os.environ.get(THREADS, "").strip()
    if not text:
        there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return min([there, *control_group_processors()])
    if not (text.isascii() and text.isdigit() and int(text)):
        raise SettingError(f"{THREADS}: found {text!r}, expected a number from 1; set one, or unset it")
    return int(text)


def limit_pools() -> None:
    """Limit the threads of libraries to ``IMUCAL_THREADS``; call this before they are loaded."""
    text = os.environ.get(THREADS, "").strip()
    if text.isascii() and text.isdigit() and int(text):
        for name in POOLS:
            os.environ.setdefault(name, text)


def single_matrix_thread() -> None:
    """Use one thread for matrices, unless a variable is set; call this before NumPy is loaded.

    Matrices are small here, and threads that wait for each other need a third more processor time.
    """
    for name in MATRICES:
        os.environ.setdefault(name, "1")


def _physical() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def control_group_limits(
    groups: Path = Path("/proc/self/cgroup"), root: Path = Path("/sys/fs/cgroup")
) -> list[int]:
    """Return the memory limits, in bytes, of this process's control group and those above it.

    Source: Linux, Documentation/admin-guide/cgroup-v1/memory.rst and cgroup-v2.rst.
    """
    found = _numbers(groups, root, "memory", ["memory.max"], ["memory.limit_in_bytes"])
    return [size for size, *others in found if not others]


def control_group_processors(
    groups: Path = Path("/proc/self/cgroup"), root: Path = Path("/sys/fs/cgroup")
) -> list[int]:
    """Return the processors that the control groups allow, rounded up.

    Source: Linux, Documentation/scheduler/sched-bwc.rst and admin-guide/cgroup-v2.rst (``cpu.max``).
    """
    # Without a limit the quota is "max", or -1.
    found = _numbers(groups, root, "cpu", ["cpu.max"], ["cpu.cfs_quota_us", "cpu.cfs_period_us"])
    return [-(-numbers[0] // numbers[1]) for numbers in found if len(numbers) == 2]


def _numbers(
    groups: Path, root: Path, controller: str, unified: list[str], own: list[str]
) -> Iterator[list[int]]:
    """Yield the numbers in the files of a process's groups and those above, if all of them are limits.

    A line of `groups` is, for example, ``4:memory:/docker/1f``. With ``0::/user.slice`` all controllers share
    their groups, whose files are the `unified` ones.
    """
    for line in _text(groups).splitlines():
        _, controllers, path = (*line.split(":", 2), "", "")[:3]
        if controllers and controller not in controllers.split(","):
            continue
        group, top = PurePosixPath(path.lstrip("/")), root / controller if controllers else root
        for part in (group, *group.parents):
            texts = (_text(top / part / name) for name in (own if controllers else unified))
            words = [word for text in texts for word in text.split()]
            if words and all(word.isdecimal() and int(word) > 0 for word in words):
                yield list(map(int, words))


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""
