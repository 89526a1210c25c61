"""Limits of memory and threads: from the machine, its container, or environment variables.

``IMUCAL_MEMORY`` limits the memory of one step (``500M``, ``2G``), ``IMUCAL_THREADS`` the number of threads,
including library threads.
"""

import os
import sys
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
#: One step may use the memory divided by this.
_SHARE = 4
#: The control groups of this process, and the folder of all groups.
_OWN_GROUP = Path("/proc/self/cgroup")
_GROUPS = Path("/sys/fs/cgroup")
#: Start of the line of a group of version 2.
_UNIFIED = "0::"
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


def threads() -> int:
    """Return the number of threads: ``IMUCAL_THREADS``, or the processors that this process may use.

    Raises SettingError if ``IMUCAL_THREADS`` is not a positive integer.
    """
    text = os.environ.get(THREADS, "").strip()
    if not text:
        return min([_processors(), *control_group_processors()])
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


def _processors() -> int:
    """Return the processors that this process may use."""
    if sys.version_info >= (3, 13):
        return os.process_cpu_count() or 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _physical() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def control_group_limits(groups: Path = _OWN_GROUP, root: Path = _GROUPS) -> list[int]:
    """Return the memory limits, in bytes, of this process's control group and those above it.

    Source: Linux, Documentation/admin-guide/cgroup-v2.rst (``memory.max``).
    """
    return [int(text) for text in _limits(groups, root, "memory.max") if text.isdecimal()]


def control_group_processors(groups: Path = _OWN_GROUP, root: Path = _GROUPS) -> list[int]:
    """Return the processors that the control groups allow, rounded up.

    Source: Linux, Documentation/admin-guide/cgroup-v2.rst (``cpu.max``: a quota, or "max", and its period).
    """
    pairs = [text.split() for text in _limits(groups, root, "cpu.max")]
    return [-(-int(quota) // int(period)) for quota, period in pairs if quota.isdecimal()]


def _limits(groups: Path, root: Path, name: str) -> Iterator[str]:
    """Yield the text of a file in this process's control group (version 2) and in those above it."""
    own = next((line for line in _text(groups).splitlines() if line.startswith(_UNIFIED)), None)
    if own is None:
        return
    group = PurePosixPath(own.removeprefix(_UNIFIED).lstrip("/"))
    for part in (group, *group.parents):
        if text := _text(root / part / name).strip():
            yield text


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""
