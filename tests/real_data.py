"""Where the real recordings are; tests that need them skip with a reason when there are none."""

import os
from pathlib import Path

import pytest

__all__ = ["real_data"]

_DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "data"


def real_data(*parts: str) -> Path:
    """Return a file of the real-data folder, or skip the test."""
    folder = Path(os.environ.get("IMUCAL_REAL_DATA", _DEFAULT))
    path = folder.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"no real data: {'/'.join(parts)} not found; set IMUCAL_REAL_DATA to its folder")
    return path
