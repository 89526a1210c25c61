"""How much memory one step may take before it works out of core."""

import os

_UNKNOWN = 2_000_000_000


def memory_limit() -> int:
    """Return a quarter of the machine's memory, in bytes; 2 GB where it can't be asked."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
    except (AttributeError, ValueError, OSError):
        return _UNKNOWN
