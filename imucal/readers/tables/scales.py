"""The unit of a table's samples: as given, from the header, from the format, or inferred; and why."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from imucal.arrays import FloatArray
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.read_options import ReadOptions
from imucal.readers.tables.columns import Triad
from imucal.readers.tables.inference import infer_accel_unit, infer_gyro_unit, sample_of
from imucal.readers.tables.signatures import Signature
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS, parse_sample_unit


@dataclass(slots=True, kw_only=True)
class Work:
    """What is known while a recording is put together."""

    path: str
    options: ReadOptions
    signature: Signature | None
    rate_hz: float | None
    decisions: list[tuple[str, str]] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)

    def decide(self, what: str, how: str) -> None:
        if (what, how) not in self.decisions:
            self.decisions.append((what, how))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unscaled:
    """A sensor's samples in the unit of the log.

    Attributes
    ----------
    triad
        Which columns they are.
    axes
        x, y, z; shape (n,) each.
    rate_hz
        Sampling rate.
    """

    triad: Triad
    axes: Sequence[FloatArray]
    rate_hz: float


def find_scales(work: Work, timed: Sequence[Unscaled]) -> dict[Sensor, float]:
    """Return SI per unit of the log for each sensor; the accelerometer first, as it tells of the other."""
    scales: dict[Sensor, float] = {}
    accel_unit: str | None = None
    for entry in sorted(timed, key=lambda entry: entry.triad.sensor is Sensor.GYROSCOPE):
        sensor = entry.triad.sensor
        stated = _stated_scale(work, entry)
        if stated is None:
            stated = _inferred_accel(work, entry) if sensor is Sensor.ACCELEROMETER else None
        if stated is None:
            stated = _inferred_gyro(work, entry, accel_unit)
        unit, scales[sensor], reason = stated
        if sensor is Sensor.ACCELEROMETER:
            accel_unit = unit
        work.decide(f"{sensor} unit", f"{unit}, {reason}")
    return scales


def _stated_scale(work: Work, entry: Unscaled) -> tuple[str, float, str] | None:
    """Return unit, scale and reason where the user, the header or the format states the unit."""
    triad = entry.triad
    gyro = triad.sensor is Sensor.GYROSCOPE
    options, signature = work.options, work.signature
    unit = options.gyro_unit if gyro else options.accel_unit
    scale = options.gyro_scale if gyro else options.accel_scale
    if unit is not None and scale is not None:
        msg = (
            f"{work.path}: both a unit ({unit}) and a scale ({scale:g}) are given for the {triad.sensor}; "
            "expected one of them"
        )
        raise ChoiceError(msg)
    if scale is not None:
        return "count", scale, f"{scale:g} {triad.sensor.unit} per count as given"
    if unit is not None:
        parsed = parse_sample_unit(unit)
        if parsed is None or parsed[0] is not triad.sensor:
            known = ", ".join(SAMPLE_UNITS[triad.sensor])
            msg = f"{work.path}: {unit!r} is no unit of the {triad.sensor}; expected one of {known}"
            raise ChoiceError(msg)
        return parsed[1], SAMPLE_UNITS[triad.sensor][parsed[1]], "as given"
    if triad.unit is not None:
        return triad.unit, SAMPLE_UNITS[triad.sensor][triad.unit], "from the column header"
    known_unit = None if signature is None else signature.gyro_unit if gyro else signature.accel_unit
    if known_unit is not None and signature is not None:
        return known_unit, SAMPLE_UNITS[triad.sensor][known_unit], f"as {signature.name} logs it"
    return None


def _inferred_accel(work: Work, entry: Unscaled) -> tuple[str, float, str]:
    found = infer_accel_unit(sample_of(entry.axes))
    if found.unit is None:
        known = ", ".join(SAMPLE_UNITS[Sensor.ACCELEROMETER])
        msg = (
            f"{work.path}: the unit of the accelerometer is open: no header says it, and {found.reason}; "
            f"expected one of {known}; give its unit, or the scale of its counts in m/s^2 per count"
        )
        raise ChoiceError(msg)
    scale = found.scale if found.scale is not None else SAMPLE_UNITS[Sensor.ACCELEROMETER][found.unit]
    return found.unit, scale, f"inferred: {found.reason}"


def _inferred_gyro(work: Work, entry: Unscaled, accel_unit: str | None) -> tuple[str, float, str]:
    found = infer_gyro_unit(sample_of(entry.axes), rate_hz=entry.rate_hz, accel_unit=accel_unit)
    if found.unit is None:
        known = ", ".join(SAMPLE_UNITS[Sensor.GYROSCOPE])
        msg = (
            f"{work.path}: the unit of the gyroscope is open: no header says it, and {found.reason}; "
            f"expected one of {known}; give its unit, or the scale of its counts in rad/s per count"
        )
        raise ChoiceError(msg)
    if not found.sure:
        text = f"The unit of the gyroscope is taken to be {found.unit}: {found.reason}."
        advice = (
            "Give its unit if that is wrong: deg/s instead of rad/s changes every result by a factor of 57."
        )
        work.findings.append(
            Finding(level="warning", code="unit-assumed", axis="gyro", text=text, advice=advice)
        )
    return found.unit, SAMPLE_UNITS[Sensor.GYROSCOPE][found.unit], f"inferred: {found.reason}"
