"""Interpreters that can import a consumer, and the output of its probe for an exported file.

The interpreter of the tests is included. ``IMUCAL_CONSUMERS`` lists others, separated by colons: GTSAM 4.2
needs NumPy 1, which imucal does not support.
"""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

__all__ = ["interpreters", "probe"]

_HERE = Path(__file__).parent


def interpreters(package: str) -> Iterator[str]:
    """Yield the interpreters that can import a package."""
    for python in (sys.executable, *filter(None, os.environ.get("IMUCAL_CONSUMERS", "").split(":"))):
        asked = [python, "-c", f"import importlib.util as u, sys; sys.exit(u.find_spec({package!r}) is None)"]
        if subprocess.run(asked, check=False).returncode == 0:  # noqa: S603 - the developer's own
            yield python


def probe(python: str, package: str, file: Path) -> dict[str, Any]:
    """Return the output of a package's probe for a file."""
    script = _HERE / f"{package}_probe.py"
    done = subprocess.run([python, script, file], check=True, capture_output=True, text=True)  # noqa: S603
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found
