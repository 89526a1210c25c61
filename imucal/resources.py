"""What may be taken of the machine: memory and threads, as there are, as a container limits them, or as set.

``IMUCAL_MEMORY`` is the memory that one step may take (``500M``, ``2G``), ``IMUCAL_THREADS`` the number of
threads, also those of the libraries beneath.
"""

import os
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from imucal.errors import SettingError

MEMORY, THREADS = "IMUCAL_MEMORY", "IMUCAL_THREADS"

#: Memory that one step may take, in bytes, where the machine does not say how much it has.
_UNKNOWN = 2_000_000_000
#: Bytes of samples that are held at most without being asked.
_COLUMNS = 500_000_000
#: The share of the memory that one step may take.
_SHARE = 4
_SIZE = re.compile(r"(?P<number>\d+(?:\.\d*)?)\s*(?P<prefix>[kmgt]?)i?b?", re.IGNORECASE)
_PREFIXES = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}
#: What the libraries of matrices read when they are loaded, and all libraries beneath.
MATRICES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
POOLS = ("POLARS_MAX_THREADS", "RAYON_NUM_THREADS", "OMP_NUM_THREADS", *MATRICES)


def memory_limit() -> int:
    """Return how many bytes one step may take: ``IMUCAL_MEMORY``, or a quarter of the memory there is.

    There is what the machine has, or what its control group (a container, a job) may take if that is less.
    A SettingError says that ``IMUCAL_MEMORY`` is no size.
    """
    size = size_setting(MEMORY)
    if size is not None:
        return size
    there_is = memory_there_is()
    return there_is // _SHARE if there_is else _UNKNOWN


def size_setting(name: str, *, least: int = 1) -> int | None:
    """Return the bytes that an environment variable says, such as ``500M``; None where it is not set.

    A SettingError says that it is no size, or less than `least`.
    """
    text = os.environ.get(name, "").strip()
    if not text:
        return None
    try:
        return parse_size(text, least=least)
    except ValueError as error:
        raise SettingError(f"{name}: found {text!r}, expected {error}; set one, or unset it") from error


def memory_there_is() -> int | None:
    """Return how many bytes of memory the machine has, or its control group may take if that is less."""
    return min((size for size in (_physical(), *control_group_limits()) if size), default=None)


def parse_size(text: str, *, least: int = 1) -> int:
    """Return the bytes of a size such as ``500M`` or ``2GB``; a K is 1024.

    A ValueError, of none or one less than `least`, says what is expected.
    """
    match = _SIZE.fullmatch(text.strip())
    size = float(match["number"]) * _PREFIXES[match["prefix"].lower()] if match else -1
    if size < least:
        raise ValueError("a size such as 500M or 2G")
    return int(size)


def column_limit() -> int:
    """Return how many bytes of samples may be held before a temporary file takes them.

    It is ``IMUCAL_MEMORY`` where that is set, a SettingError where it is no size; else half a gigabyte, or
    what one step may take if less.
    """
    limit = memory_limit()
    return limit if os.environ.get(MEMORY, "").strip() else min(limit, _COLUMNS)


def threads() -> int:
    """Return how many threads may work: ``IMUCAL_THREADS``, or the processors that this process may use.

    Those are the ones it may run on, or as many as its control group (a container) has time of, if fewer. A
    SettingError says that ``IMUCAL_THREADS`` is no positive number.
    """
    text = os.environ.get(THREADS, "").strip()
    if not text:
        there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        return min([there, *control_group_processors()])
    if not (text.isascii() and text.isdigit() and int(text)):
        raise SettingError(f"{THREADS}: found {text!r}, expected a number from 1; set one, or unset it")
    return int(text)


def limit_pools() -> None:
    """Let the libraries beneath start no more threads than ``IMUCAL_THREADS``; before they are loaded."""
    text = os.environ.get(THREADS, "").strip()
    if text.isascii() and text.isdigit() and int(text):
        for name in POOLS:
            os.environ.setdefault(name, text)


def single_matrix_thread() -> None:
    """Let one thread multiply matrices, unless something else is set; before NumPy is loaded.

    They are small here, and threads that wait for each other in a loop take a third more processor time.
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
    """Return the limits of memory, in bytes, of this process's control group and those above it.

    Source: Linux, Documentation/admin-guide/cgroup-v1/memory.rst and cgroup-v2.rst.
    """
    found = _numbers(groups, root, "memory", ["memory.max"], ["memory.limit_in_bytes"])
    return [size for size, *others in found if not others]


def control_group_processors(
    groups: Path = Path("/proc/self/cgroup"), root: Path = Path("/sys/fs/cgroup")
) -> list[int]:
    """Return how many processors' time this process's control group and those above it have, rounded up.

    Source: Linux, Documentation/scheduler/sched-bwc.rst and admin-guide/cgroup-v2.rst (``cpu.max``).
    """
    # The quota of a group without one is "max", or -1.
    found = _numbers(groups, root, "cpu", ["cpu.max"], ["cpu.cfs_quota_us", "cpu.cfs_period_us"])
    return [-(-numbers[0] // numbers[1]) for numbers in found if len(numbers) == 2]


def _numbers(
    groups: Path, root: Path, controller: str, unified: list[str], own: list[str]
) -> Iterator[list[int]]:
    """Yield the numbers in files of a process's groups and those above, where all of them limit something.

    A line of `groups` is such as ``4:memory:/docker/1f``; or ``0::/user.slice`` where all controllers have
    the same groups, and the files are the `unified` ones instead of the controller's own.
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
    """Return the text of a file; none where there is no such file."""
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""
