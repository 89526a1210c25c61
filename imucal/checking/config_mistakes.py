"""Eight likely mistakes in the config file of a filter, and the choice of the one that explains a number.

1. continuous instead of sampled noise, or the other way round: a factor sqrt(f)
2. the conversion from continuous to sampled noise made twice: a factor f
3. degrees instead of radians, or the conversion made twice
4. g instead of m/s², or the conversion made twice
5. a number in another unit of a data sheet
6. the number of the other sensor
7. the number of another term: N and K swapped, or B in place of K
8. a variance instead of a standard deviation, or the other way round
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.report.exports.target import Formula
from imucal.units import G0

#: A number matches a mistake within this factor.
_NEAR = 1.35
#: The same for a small excess, which may be on purpose.
_NEAR_ON_PURPOSE = 1.1
#: Largest excess that may be on purpose, as a factor.
_ON_PURPOSE = 30.0
#: The same for a mistake of several numbers, of which one must match as above. K is often only bounded, and
#: then the exporter's number is up to twice the number of the truth.
_NEAR_SHARED = 2.0
#: Two mistakes fit equally if the numbers that they give differ by less than this factor.
_EQUALLY = 1.1
#: Largest difference of the natural logarithms of equal factors.
_EQUAL = 1e-6

#: Mistakes that a file makes in all its numbers or in none, because it has one convention.
_CONVENTIONS = ("continuous", "sampled")
#: Units of data sheets by the symbol of the term. Degrees and g alone are mistakes of their own.
_SHEET_UNITS = {
    "N": ("mdeg/s/sqrt(Hz)", "deg/h/sqrt(Hz)", "deg/sqrt(h)", "mg/sqrt(Hz)", "ug/sqrt(Hz)", "m/s/sqrt(h)"),
    "K": ("mdeg/s/sqrt(s)", "deg/h/sqrt(s)", "deg/h/sqrt(h)", "mg/sqrt(s)", "ug/sqrt(s)"),
}
#: Symbol of a term -> terms whose numbers people write in its place.
_IN_PLACE_OF = {"N": "K", "K": "BN"}


class Mistake(NamedTuple):
    """A likely mistake: its name in all keys, the number that it gives, and the message."""

    name: str
    number: float
    message: str
    #: Whether people also make a number as large on purpose.
    on_purpose: bool = False


@dataclass(frozen=True)
class RightNumber:
    """The right number of a key and the coefficients from which people make wrong ones.

    Attributes
    ----------
    sensor, symbol, formula
        Those of the key.
    right
        The number that imucal writes.
    rate_hz
        Rate of the file's stream.
    fitted
        The largest fitted coefficients of the sensor by their symbols, in SI.
    elsewhere
        The required and the fitted coefficient of the other sensor, as far as there are any.
    """

    sensor: Sensor
    symbol: str
    formula: Formula
    right: float
    rate_hz: float
    fitted: Mapping[str, float]
    elsewhere: Sequence[float]

    def over(self, number: float) -> float:
        """Return the coefficient of a number as a multiple of the right one."""
        return float((number / self.right) ** (1 / self.formula.power))

    def distances(self, number: float) -> dict[str, float]:
        """Return the distance of a number from each mistake that may explain it, by the mistake's name."""
        distances: dict[str, float] = {}
        for mistake in self._mistakes():
            distance = self._distance(number, mistake)
            if distance < self._tolerance(mistake, _NEAR_SHARED):
                distances[mistake.name] = min(distance, distances.get(mistake.name, math.inf))
        return distances

    def explanations(self, number: float, shared: str = "") -> tuple[Mistake, ...]:
        """Return the shared mistake, or the nearest ones if they fit equally; empty if none is near."""
        mistakes = [mistake for mistake in self._mistakes() if shared in {"", mistake.name}]
        mistakes.sort(key=lambda mistake: self._distance(number, mistake))
        if not mistakes:
            return ()
        nearest = self._distance(number, mistakes[0])
        near = _NEAR_SHARED if shared else _NEAR
        explanations: dict[str, Mistake] = {}
        for mistake in mistakes:
            distance = self._distance(number, mistake)
            if distance < min(self._tolerance(mistake, near), nearest + math.log(_EQUALLY)):
                explanations.setdefault(mistake.name, mistake)
        if not explanations and shared in _CONVENTIONS:
            size = "small" if number < mistakes[0].number else "large"
            also = f", as in the file's other numbers, and {math.exp(nearest):.3g} times too {size} as such"
            return (mistakes[0]._replace(message=f"{mistakes[0].message}{also}"),)
        return tuple(explanations.values())

    def _distance(self, number: float, mistake: Mistake) -> float:
        """Return the difference of the natural logarithms of two coefficients."""
        return abs(math.log(number / mistake.number)) / self.formula.power

    def _tolerance(self, mistake: Mistake, near: float) -> float:
        """Return the largest distance at which a mistake explains a number."""
        return math.log(_NEAR_ON_PURPOSE if 1 < self.over(mistake.number) < _ON_PURPOSE else near)

    def _mistakes(self) -> Iterator[Mistake]:
        right = self.formula.inverse(self.right, self.rate_hz)
        for coefficient in sorted({right, self.fitted.get(self.symbol, 0.0)} - {0.0}):
            numbers = [self._number(coefficient)]
            for mistake in self._of_coefficient(coefficient):
                if not any(math.isclose(mistake.number, number, rel_tol=_EQUAL) for number in numbers):
                    numbers.append(mistake.number)
                    yield mistake._replace(message=self._factor(mistake, coefficient) + mistake.message)
        for coefficient in self.elsewhere:
            other = next(other for other in Sensor if other is not self.sensor)
            message = f"{self.symbol} of the {other}, in place of {self.symbol} of the {self.sensor}"
            yield Mistake("sensor", self._number(coefficient), message)
        for symbol in _IN_PLACE_OF[self.symbol]:
            if coefficient := self.fitted.get(symbol, 0.0):
                names = [f"{each}, the {TERMS[each].name(self.sensor)}" for each in (symbol, self.symbol)]
                # N and K are swapped together.
                name = "bias instability" if symbol == "B" else "terms"
                yield Mistake(name, self._number(coefficient), ", in place of ".join(names))

    def _number(self, coefficient: float) -> float:
        return self.formula.of(coefficient, self.rate_hz)

    def _factor(self, mistake: Mistake, coefficient: float) -> str:
        """Return ``by sqrt(f) at 200 Hz: `` if a mistake is a well-known factor on the coefficient."""
        size = abs(math.log(self.formula.inverse(mistake.number, self.rate_hz) / coefficient))
        f = self.rate_hz
        factors = {
            f"sqrt(f) at {f:g} Hz": math.sqrt(f),
            f"f = {f:g} Hz": f,
            "57.3": 180 / math.pi,
            "9.81": G0,
        }
        return next((f"by {name}: " for name, x in factors.items() if abs(size - math.log(x)) < _EQUAL), "")

    def _of_coefficient(self, c: float) -> Iterator[Mistake]:
        """Yield the mistakes that begin with the right coefficient."""
        f, root, symbol = self.rate_hz, math.sqrt(self.rate_hz), self.symbol
        deviation = Mistake("sampled", c * root, f"{symbol}*sqrt(f), the deviation of one sample")
        step = Mistake("sampled", c / root, f"{symbol}/sqrt(f), the step of one sample")
        yield Mistake("continuous", c, f"{symbol}, the continuous density")
        yield deviation if symbol == "N" else step
        wrong_way = step if symbol == "N" else deviation
        yield wrong_way._replace(name="wrong way")
        yield Mistake("one root more", self._number(c * root), "one such factor too many")
        yield Mistake("one root less", self._number(c / root), "one such factor is missing")
        yield Mistake("one rate more", self._number(c * f), "one factor of the rate too many")
        yield Mistake("one rate less", self._number(c / f), "one factor of the rate is missing")
        yield Mistake("variance", c * c * f, f"{symbol}^2*f, the variance of one sample")
        yield Mistake("square", c * c, f"{symbol}^2, the square of the continuous density")
        yield from self._in_other_units(c)

    def _in_other_units(self, c: float) -> Iterator[Mistake]:
        symbol, sensor = self.symbol, self.sensor
        units = TERMS[symbol].coefficient_units(sensor)
        wanted, per = next(iter(units)), "sqrt(Hz)" if symbol == "N" else "sqrt(s)"
        if sensor is Sensor.GYROSCOPE:
            alone, factor, on_purpose = "deg/s", math.radians(1.0), ""
        else:
            # People multiply by ten, which is nearly 9.81.
            alone, factor, on_purpose = "g", G0, ", or made ten times as large on purpose"
        yield Mistake(alone, self._number(c / factor), f"it is in {alone}/{per}, not in {wanted}")
        twice = f"it was converted from {alone} into SI twice{on_purpose}"
        yield Mistake(f"{alone} twice", self._number(c * factor), twice, on_purpose=bool(on_purpose))
        for unit in _SHEET_UNITS[symbol]:
            if unit in units:
                number = self._number(c / units[unit])
                yield Mistake(f"unit {units[unit]:.3g}", number, f"it is in {unit}, not in {wanted}")


def shared_mistake(numbers: Sequence[tuple[RightNumber, float]]) -> str:
    """Return the name of one mistake that explains several wrong numbers of a file; empty if none does.

    It explains all of them; but two numbers of one convention are enough, because a file has only one.
    """
    distances = [key.distances(number) for key, number in numbers]
    near = Counter(name for each in distances for name in each if each[name] < math.log(_NEAR))
    shared = [name for name in near if len(distances) > 1 and all(name in each for each in distances)]
    if not shared:
        shared = [name for name in _CONVENTIONS if near[name] > 1]
    totals = {name: sum(each.get(name, 0.0) for each in distances) for name in sorted(shared)}
    return min(totals, key=lambda name: totals[name], default="")
