"""Temperatures of tables: values outside the range of electronics are ignored."""

from pathlib import Path

import pytest

from imucal.readers.read_options import ReadOptions
from imucal.readers.reading import read_one as read


@pytest.mark.parametrize(
    ("degrees", "taken"),
    [(25.0, True), (200.0, True), (200.5, False), (300.0, False), (-80.0, True), (-80.5, False)],
)
def test_a_median_temperature_outside_the_range_is_ignored(
    degrees: float,
    taken: bool,  # noqa: FBT001 - of the case
    tmp_path: Path,
) -> None:
    """The range is -80 to 200 degrees Celsius. A finding reports an ignored column."""
    path = tmp_path / "log.csv"
    rows = [f"{i * 10},{i % 3 * 0.001},0.002,0.003,{degrees}" for i in range(50)]
    path.write_text("\n".join(["time_ms,gx_rad/s,gy_rad/s,gz_rad/s,temperature", *rows]), encoding="utf-8")
    recording = read(path, ReadOptions())
    decision = dict(recording.source.decisions).get("temperature")
    if taken:
        assert recording.temperature is not None
        assert decision is None
    else:
        assert recording.temperature is None
        assert decision == f"left out: a median of {degrees:.4g} is not in degrees Celsius"
