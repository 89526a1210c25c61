"""Build a `Recording` from columns of samples."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imucal.arrays import FloatArray, IntArray, blocks
from imucal.clock import Clock
from imucal.errors import ChoiceError
from imucal.findings import Finding
from imucal.readers.clocks.period import RATES
from imucal.readers.fixes import GIVE_RATE
from imucal.readers.read_options import ReadOptions
from imucal.readers.scales import Unscaled, find_units
from imucal.readers.store import Room
from imucal.recording import AxisSeries, Recording, Source, Temperature


@dataclass(slots=True, kw_only=True, eq=False)
class RecordingBuilder:
    """Collects the parts of a recording; sensors stay in the order added."""

    #: Path as given, and format.
    path: str
    format: str
    options: ReadOptions = field(default_factory=ReadOptions)
    #: Declared in the log, in Hz.
    rate_hz: float | None = None
    decisions: list[tuple[str, str]] = field(default_factory=list)
    #: See `imucal.recording.Source`.
    values: dict[str, str] = field(default_factory=dict)
    #: `build` removes duplicates.
    findings: list[Finding] = field(default_factory=list)
    series: list[AxisSeries] = field(default_factory=list)
    temperature: Temperature | None = None

    @property
    def room(self) -> Room:
        return Room(self.options.memory_limit)

    def decide(self, what: str, how: str, *, value: str = "") -> None:
        """Add a decision with its reason, and its `value` if programs need it."""
        if value:
            self.values[what] = value
        if (what, how) not in self.decisions:
            self.decisions.append((what, how))

    def add(self, samples: Sequence[Unscaled], *, where: str = "") -> None:
        """Add sensors in SI; `where` is the place in errors, by default the path.

        Raises ChoiceError if a unit is unknown or unsuitable, or if the measured rate is implausible.
        """
        for entry in samples:
            clock, given = entry.clock, self.options.rate_hz is not None or self.options.time_unit is not None
            usual = RATES[0] * 0.98 <= clock.rate_hz <= RATES[1] * 1.02
            if not given and clock.jitter_s is not None and not usual:
                raise ChoiceError(
                    f"{clock.source} gives {clock.rate_hz:.6g} Hz; expected the rate of an IMU, "
                    f"{RATES[0]:g} Hz to {RATES[1]:g} Hz",
                    place=where or self.path,
                    fix=GIVE_RATE,
                )
        units = find_units(where or self.path, self.options, samples, self.findings)
        for entry in samples:
            sensor, unit = entry.sensor, units[entry.sensor]
            self.decide(f"{sensor} unit", unit.described(sensor), value=unit.value)
            self.add_sensor(entry, unit.factor(sensor, entry.clock.rate_hz))

    def add_sensor(self, entry: Unscaled, scale: float) -> None:
        """Add the axes of a sensor; `scale` converts to SI, in place if possible."""
        for axis, values in zip(entry.axes, entry.rows, strict=True):
            samples = _scaled(_kept(values, entry.order, self.room), scale, self.room)
            self.series.append(AxisSeries(sensor=entry.sensor, axis=axis, samples=samples, clock=entry.clock))

    def add_temperature(self, samples: FloatArray, clock: Clock, *, order: IntArray | None = None) -> None:
        """Add a temperature in degrees Celsius, shape (n,); only the first one is kept."""
        if self.temperature is None:
            self.temperature = Temperature(samples=_kept(samples, order, self.room), clock=clock)

    def build(self, *, topics: Sequence[str], message_types: Sequence[str] = ()) -> Recording:
        source = Source(
            path=self.path,
            format=self.format,
            topics=tuple(topics),
            message_types=tuple(message_types),
            decisions=tuple(self.decisions),
            values=self.values,
        )
        return Recording(
            source=source,
            series=tuple(self.series),
            temperature=self.temperature,
            findings=tuple(dict.fromkeys(self.findings)),
        )


def _kept(values: FloatArray, order: IntArray | None, room: Room) -> FloatArray:
    return np.ascontiguousarray(values) if order is None else room.taken(values, order)


def _scaled(samples: FloatArray, scale: float, room: Room) -> FloatArray:
    if scale == 1.0:
        return samples
    scaled = samples if samples.flags.writeable else room.empty(samples.size, np.float64)
    for part in blocks(samples.size, samples, scaled):
        np.multiply(samples[part], scale, out=scaled[part])
    return scaled
