"""Memory of a process and its children, as counted by the system."""

import contextlib
from pathlib import Path


def memory_of_family(process: int) -> tuple[int, int]:
    """Return the bytes of a process and its children, shared ones once, and those without a file."""
    held = [_memory(one) for one in _family(process)]
    return sum(whole for whole, _ in held), sum(anonymous for _, anonymous in held)


def _family(process: int) -> list[int]:
    """Return a process and its existing descendants."""
    found = [process]
    for one in found:
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{one}/task").iterdir():
                found += map(int, (task / "children").read_text(encoding="ascii").split())
    return found


def _memory(process: int) -> tuple[int, int]:
    """Return the proportional bytes of a process, and those without a file."""
    try:
        text = Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii")
    except OSError:
        return 0, 0
    sizes = {line.split(":")[0]: line.split()[1] for line in text.splitlines()[1:]}
    return 1024 * int(sizes.get("Pss", 0)), 1024 * int(sizes.get("Pss_Anon", 0))
