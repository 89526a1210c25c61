"""The temperature of a table: degrees in which electronics work, anything else is left out."""

from pathlib import Path

import pytest

from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.text_table import read


@pytest.mark.parametrize(
    ("degrees", "taken"),
    [(25.0, True), (200.0, True), (200.5, False), (300.0, False), (-80.0, True), (-80.5, False)],
)
def test_degrees(degrees: float, taken: bool, tmp_path: Path) -> None:  # noqa: FBT001 - of the case
    """From -80 to 200 degrees Celsius by the median; a column beyond is left out, and it is said."""
    path = tmp_path / "log.csv"
    rows = [f"{i * 10},{i % 3 * 0.001},0.002,0.003,{degrees}" for i in range(50)]
    path.write_text("\n".join(["time_ms,gx_rad/s,gy_rad/s,gz_rad/s,temperature", *rows]), encoding="utf-8")
    recording = read(path, ReadOptions())
    said = dict(recording.source.decisions).get("temperature")
    if taken:
        assert recording.temperature is not None
        assert said is None
    else:
        assert recording.temperature is None
        assert said == f"left out: a median of {degrees:.4g} is not in degrees Celsius"
