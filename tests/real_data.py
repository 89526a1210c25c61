"""Access to real recordings; tests that need them are skipped if they are missing."""

import os
from pathlib import Path

import pytest

__all__ = ["real_data"]

_DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "data"


def real_data(*parts: str) -> Path:
    """Return a file of the real-data folder, or skip the test."""
    folder = Path(os.environ.get("IMUCAL_REAL_DATA", _DEFAULT))
    if not folder.is_dir():
        # All tests have the same reason, so pytest merges them into one line.
        pytest.skip("no real recordings here; set IMUCAL_REAL_DATA to the folder that holds them")
    path = folder.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{'/'.join(parts)} is missing in the folder of real recordings, {folder}")
    return path
