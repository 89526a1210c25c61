"""A part with the figures of its data sheet: noise, bias instability, ranges and steps."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.units import SAMPLE_UNITS, find_unit

#: Where the figures were read: ``secondary`` is somebody who quotes the data sheet.
Confidence: TypeAlias = Literal["manufacturer", "manufacturer front page", "secondary", "software default"]
#: Largest ratio of a measured to a typical figure that is not reported: published measurements have 0.4 to
#: 1.7 times the printed figure; of 29, one has more than 3, a disturbed accelerometer.
MOST_TYPICAL = 3.0
#: The same for a printed maximum.
MOST_MAXIMUM = 2.0
#: Typical K of MEMS chips, whose data sheets print none, in rad/s/sqrt(s) and m/s^2/sqrt(s): the medians of
#: published measurements, which are spread by a factor of 4 to both sides.
_TYPICAL_WALK = {Sensor.GYROSCOPE: 2.6e-6, Sensor.ACCELEROMETER: 1.1e-4}
#: Spread of typical K, as a factor.
WALK_SPREAD = 4
#: Sensor -> unit of its ranges in data sheets.
RANGE_UNITS = {Sensor.GYROSCOPE: "deg/s", Sensor.ACCELEROMETER: "g"}
#: Printed figure -> unit of data sheets for each sensor, by its symbol in `TERMS`.
_UNITS: dict[str, dict[Sensor, str]] = {
    "noise_density": {Sensor.GYROSCOPE: "deg/s/sqrt(Hz)", Sensor.ACCELEROMETER: "ug/sqrt(Hz)"},
    "low_frequency_rms_noise": {Sensor.GYROSCOPE: "deg/s/sqrt(Hz)", Sensor.ACCELEROMETER: "ug/sqrt(Hz)"},
}


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure as a data sheet prints it.

    Attributes
    ----------
    printed
        The text.
    si, si_xyz
        The worst axis in SI, and the axes x, y and z if they differ; None if the figure is no single number.
    kind
        ``typical``, ``maximum`` or ``upper bound as printed``.
    condition, definition
        When the figure is valid, and what a bias instability means; empty if not stated.
    source
        Document, revision and table.
    """

    printed: str
    si: float | None = None
    si_xyz: tuple[float, float, float] | None = None
    kind: str = "typical"
    condition: str = ""
    definition: str = ""
    source: str


@dataclass(frozen=True, kw_only=True)
class TermFigure:
    """N, B or K of one sensor of a part, in SI: the number to compute with.

    Attributes
    ----------
    symbol, sensor
        The term, and whose it is.
    value
        The figure of the worst axis; B is the bias instability divided by 0.664.
    kind
        Whether `value` is ``typical`` or a ``maximum``.
    maximum
        A printed maximum in addition to a typical value, or None.
    origin
        Name of the printed figure, such as ``noise_density``.
    alternative, alternative_origin
        A second figure of the same data sheet that agrees better with real units, or None.
    """

    symbol: str
    sensor: Sensor
    value: float
    kind: Literal["typical", "maximum"] = "typical"
    maximum: float | None = None
    origin: str
    alternative: float | None = None
    alternative_origin: str = ""

    @property
    def reference(self) -> float:
        """The value to compare with: the alternative, if there is one."""
        return self.value if self.alternative is None else self.alternative

    @property
    def most(self) -> float:
        """The largest measured value that is not reported as unusual."""
        if self.kind == "maximum":
            return MOST_MAXIMUM * self.reference
        maximum = float("inf") if self.maximum is None else MOST_MAXIMUM * self.maximum
        return min(MOST_TYPICAL * self.reference, maximum)

    @property
    def unit(self) -> str:
        """The unit of data sheets, such as ``deg/s/sqrt(Hz)``."""
        usual = TERMS[self.symbol].datasheet_unit(self.sensor).name
        return _UNITS.get(self.origin, {}).get(self.sensor, usual)

    def in_unit(self, value: float) -> float:
        """Return a value in SI in the unit of data sheets."""
        found = find_unit(self.unit, TERMS[self.symbol].coefficient_units(self.sensor))
        assert found is not None  # noqa: S101 - a test checks the unit of every part
        return value / found[1]


@dataclass(frozen=True, kw_only=True)
class PartSensor:
    """The gyroscope or the accelerometer of a part.

    Attributes
    ----------
    terms
        Symbol (N, B, K) -> its figure; a missing one is not printed.
    full_scale
        Ranges in deg/s or g.
    lsb_per_unit
        Counts per deg/s or g, one for each range or one for all.
    figures
        Name -> printed figure: noise, ranges, bandwidth, temperature coefficient.
    """

    sensor: Sensor
    terms: Mapping[str, TermFigure] = field(default_factory=dict)
    full_scale: tuple[float, ...] = ()
    lsb_per_unit: tuple[float, ...] = ()
    figures: Mapping[str, Figure] = field(default_factory=dict)

    @property
    def steps(self) -> tuple[float, ...]:
        """Sizes of a count in SI, one for each range."""
        factor = SAMPLE_UNITS[self.sensor][RANGE_UNITS[self.sensor]]
        return tuple(factor / counts for counts in self.lsb_per_unit)

    @property
    def floor(self) -> Figure | None:
        """The bias instability as printed: the lowest Allan deviation, if B was computed from it."""
        return self.figures.get("bias_instability") if "B" in self.terms else None


@dataclass(frozen=True, kw_only=True)
class Part:
    """A chip, module or device with the figures of its data sheet.

    Attributes
    ----------
    aliases
        Other names, such as another part with the same data sheet.
    kind
        ``chip``, ``module`` or ``device``.
    confidence
        Where the figures were read: ``manufacturer`` (the data sheet), ``manufacturer front page``,
        ``secondary`` (somebody quotes it) or ``software default``.
    note
        What to know before the figures are used.
    sensors
        The gyroscope and the accelerometer; one without figures is missing.
    """

    name: str
    manufacturer: str
    kind: str
    confidence: Confidence
    aliases: tuple[str, ...] = ()
    note: str = ""
    sensors: Mapping[Sensor, PartSensor]

    def __repr__(self) -> str:
        lines = [f"{self.manufacturer} {self.name} ({self.kind}; figures: {self.confidence})"]
        for sensor, own in self.sensors.items():
            values = ", ".join(f"{symbol} {term.value:.4g}" for symbol, term in own.terms.items())
            lines.append(f"{sensor} in SI: {values or 'no noise figure'}")
        return "\n".join(lines)

    def term(self, sensor: Sensor, symbol: str) -> TermFigure | None:
        """Return N, B or K of a sensor, or None if the data sheet does not print it."""
        own = self.sensors.get(sensor)
        return None if own is None else own.terms.get(symbol)

    def typical_walk(self, sensor: Sensor) -> float | None:
        """Return the median K of measured MEMS sensors; None for modules, which may be of another kind."""
        return None if self.kind == "module" else _TYPICAL_WALK[sensor]

    @property
    def terms(self) -> tuple[TermFigure, ...]:
        """All terms, the gyroscope's first."""
        return tuple(term for own in self.sensors.values() for term in own.terms.values())

    @property
    def sources(self) -> tuple[str, ...]:
        """The documents of all figures, each once."""
        found = (figure.source for own in self.sensors.values() for figure in own.figures.values())
        return tuple(dict.fromkeys(found))
