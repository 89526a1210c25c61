"""NoiseModel: a sum of independent noise terms, and its text form."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ArgumentError
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import TERMS, in_order, symbol_of
from imucal.recording import Sensor
from imucal.units import find_unit
from imucal.user_input import split_number

_TERM = re.compile(r"\s*(?:(?P<count>[1-9]\d*)\s*\*\s*)?(?P<symbol>[A-Za-z][A-Za-z0-9]*)\s*")
_TIMES = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_EXAMPLE = "such as 'N=1e-3 + B=2e-5 + K=3e-6 + GM(sigma=1e-4, T=50)'"


@dataclass(frozen=True, kw_only=True)
class NoiseModel:
    """A sum of independent terms.

    ``str(model)`` lists the terms (``N + B + K``); `text` includes their values.
    """

    terms: tuple[NoiseTerm, ...]

    @classmethod
    def parse(cls, text: str, sensor: Sensor = Sensor.GYROSCOPE) -> "NoiseModel":
        """Return the model of a text such as ``N=1e-3 + K=3e-6 + GM(sigma=1e-4, T=50)``.

        A number is in SI, or has a unit of the `sensor` as in data sheets: ``N=0.3deg/sqrt(h) + B=5 °/h``.

        Raises
        ------
        ValueError
            If the text is not a sum of terms with values, a unit does not belong to its term, or a term
            other than GM is duplicated.
        """
        # Split at plus signs, except in exponents and parentheses.
        parts = re.split(r"(?<![\d.][eE])\+(?![^(]*\))", text)
        terms = tuple(_parse_term(part, sensor) for part in parts)
        _refuse_repeats(tuple(term.symbol for term in terms))
        return cls(terms=terms)

    def __str__(self) -> str:
        return structure_text(term.symbol for term in self.terms)

    def text(self) -> str:
        """Return the model with its values; `parse` restores it exactly."""
        return " + ".join(term.text() for term in self.terms)

    def avar(self, m: FloatArray, *, rate_hz: float) -> FloatArray:
        """Return the exact Allan variance at averaging factors `m`, shape (k,), in U²."""
        return self._total("avar", m, rate_hz)

    def psd(self, f: FloatArray, *, rate_hz: float) -> FloatArray:
        """Return the exact two-sided psd at frequencies `f` in Hz, shape (k,), in U²/Hz."""
        return self._total("psd", f, rate_hz)

    def structure(self, k: FloatArray, *, rate_hz: float) -> FloatArray:
        """Return the mean square difference of samples `k` apart, shape (j,), in U²."""
        return self._total("structure", k, rate_hz)

    def sum_variance(self, n: FloatArray, *, rate_hz: float) -> FloatArray:
        """Return V(n), the generalised variance of the sum of `n` samples, shape (j,), in U²."""
        return self._total("sum_variance", n, rate_hz)

    def _total(self, formula: str, at: FloatArray, rate_hz: float) -> FloatArray:
        at = np.asarray(at, dtype=np.float64)
        total = np.zeros(at.shape)
        for term in self.terms:
            total += getattr(term, formula)(at, 1 / rate_hz)
        return total

    def simulate(self, n: int, *, rate_hz: float, rng: np.random.Generator) -> FloatArray:
        """Return `n` samples of the sum of all terms, shape (n,), in U."""
        samples = np.zeros(n)
        for term in self.terms:
            samples += term.simulate(n, 1 / rate_hz, rng)
        return samples


def parse_structure(text: str) -> tuple[str, ...]:
    """Return the symbols of a text such as ``N + 2*GM + K``, in the order of `TERMS`.

    Common abbreviations are accepted. An unknown term, or a duplicate of a term other than GM, is a
    ValueError.
    """
    symbols: list[str] = []
    for part in text.split("+"):
        match = _TERM.fullmatch(part)
        symbol = symbol_of(match["symbol"]) if match else None
        if match is None or symbol is None:
            known = ", ".join(TERMS)
            msg = f"model {text!r}: {part.strip()!r} is not one of {known}; write 'N + B + K' or 'N + 2*GM'"
            raise ArgumentError(msg)
        symbols += [symbol] * int(match["count"] or 1)
    _refuse_repeats(tuple(symbols))
    return in_order(symbols)


def structure_text(symbols: Iterable[str]) -> str:
    """Return a text such as ``N + 2*GM + K``."""
    ordered = tuple(symbols)
    counts = {symbol: ordered.count(symbol) for symbol in dict.fromkeys(ordered)}
    return " + ".join(symbol if count == 1 else f"{count}*{symbol}" for symbol, count in counts.items())


def _parse_term(part: str, sensor: Sensor) -> NoiseTerm:
    for term in TERMS.values():
        found = term.parameter_texts(part)
        if found is not None:
            what = f"{term.symbol}, the {term.name(sensor)} of the {sensor}"
            coefficient = _number(found[0], what, term.coefficient_units(sensor))
            return term.of(coefficient, *(_number(text, f"a time of {what}", _TIMES) for text in found[1:]))
    raise ArgumentError(f"model term {part.strip()!r} is not understood; write a sum {_EXAMPLE}")


def _number(text: str, what: str, units: Mapping[str, float]) -> float:
    parts = split_number(text)
    if parts is None:
        raise ArgumentError(f"{text!r} is not a number; write a sum {_EXAMPLE}")
    number, name = parts
    if not name:
        return number
    unit = find_unit(name, units)
    if unit is None:
        msg = f"{text!r}: {name!r} is no unit of {what}; expected one of {', '.join(units)}"
        raise ArgumentError(msg)
    return number * unit[1]


def _refuse_repeats(symbols: tuple[str, ...]) -> None:
    for symbol in set(symbols):
        if symbols.count(symbol) > 1 and not TERMS[symbol].repeatable:
            only = " and ".join(name for name, term in TERMS.items() if term.repeatable)
            raise ArgumentError(f"{symbol} appears more than once; only {only} may")
