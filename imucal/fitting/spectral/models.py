"""Models: which terms, output filter and regressors each row of a fit has.

Each model has one row of parameters, with the same columns for all models:

    log variances of the slots | logs of the times of the slots after the power laws | response a_1 … a_j

A slot is a place for one term. The power laws Q, N, B, K have one slot each; the other terms have as many
slots as a model may have terms of that kind.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from imucal.arrays import BoolArray, FloatArray, IntArray
from imucal.fitting.spectral.ordinates import LAWS, SHAPED
from imucal.noise.terms import ALWAYS, TERMS, GaussMarkov, in_order, term_keys

#: Symbols of a model's terms in the order of `imucal.noise.TERMS`.
Structure = tuple[str, ...]

#: Shortest correlation time of `auto`, in samples: a shorter one belongs to an output filter.
SHORTEST = 10.0
#: Shortest correlation time of a given model, in samples.
SHORTEST_GIVEN = 2.0

#: Symbol of a power-law term -> its column in a row of parameters.
COLUMN = {law.value: index for index, law in enumerate(LAWS)}


@dataclass(frozen=True, kw_only=True, eq=False)
class Models:
    """The terms, regressors and response orders of c models.

    `has`, shape (c, s), masks the symbols `slots` in each model, `regressors`, shape (c, r), the regressors
    `names`. `poles`, shape (c,), are the numbers of response coefficients; a row has `room_poles` columns for
    them. Correlation times are at least `shortest` samples.
    """

    slots: tuple[str, ...]
    has: BoolArray
    poles: IntArray
    regressors: BoolArray
    names: tuple[str, ...]
    room_poles: int
    shortest: float

    @property
    def count(self) -> int:
        """Number of models, c."""
        return len(self.has)

    @property
    def variances(self) -> int:
        """Number of variances in a row, s."""
        return len(self.slots)

    @property
    def response(self) -> int:
        """First column of the response."""
        return 2 * len(self.slots) - SHAPED

    @property
    def width(self) -> int:
        """Number of parameters in a row, p."""
        return self.response + self.room_poles

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self.slots[SHAPED:]))

    @property
    def free(self) -> BoolArray:
        """Mask of the parameters in each model, shape (c, p)."""
        timed = np.array([has_time(symbol) for symbol in self.slots[SHAPED:]], dtype=bool)
        has_pole = np.arange(self.room_poles) < self.poles[:, None]
        return np.concatenate([self.has, self.has[:, SHAPED:] & timed, has_pole], axis=1)

    @property
    def parameters(self) -> IntArray:
        """Number of parameters of each model, regressors included."""
        return np.asarray(self.free.sum(axis=1) + self.regressors.sum(axis=1))

    @property
    def structures(self) -> list[Structure]:
        symbols = np.array([*self.slots, *self.names])
        named = self.regressors & (np.array(self.names) == "R")
        every = np.concatenate([self.has, named], axis=1)
        return [in_order(symbols[row].tolist()) for row in every]

    def __getitem__(self, index: IntArray | BoolArray | list[int]) -> "Models":
        rows = ("has", "poles", "regressors")
        return replace(self, **{name: getattr(self, name)[index] for name in rows})

    def with_laws(self, symbols: Iterable[str]) -> "Models":
        has = self.has.copy()
        has[:, [COLUMN[symbol] for symbol in symbols]] = True
        return replace(self, has=has)

    def without(self, columns: Iterable[int], *, ramp: bool) -> "Models":
        has = self.has.copy()
        has[:, list(columns)] = False
        keep = np.array([not (ramp and name == "R") for name in self.names], dtype=bool)
        return replace(self, has=has, regressors=self.regressors & keep)

    def columns(self, theta: FloatArray) -> list[tuple[str, int]]:
        """Return name and column of each parameter of the first model except R, such as ("GM1.T", 5).

        Several Gauss-Markov terms are ``GM1``, ``GM2`` …, sorted by rising time in `theta`.
        """
        slots = np.flatnonzero(self.has[0]).tolist()
        time = {at: at + len(self.slots) - SHAPED for at in slots if at >= SHAPED}
        slots.sort(key=lambda at: (self.slots.index(self.slots[at]), theta[time[at]] if at in time else 0.0))
        columns: list[tuple[str, int]] = []
        for key, at in zip(term_keys(self.slots[at] for at in slots), slots, strict=True):
            names = TERMS[self.slots[at]].parameter_names(key)
            columns += zip(names, (at, time.get(at, at)), strict=False)
        return columns


def shaped_symbols(structure: Iterable[str]) -> list[str]:
    """Return the symbols of the terms that are neither power laws nor the ramp."""
    return [symbol for symbol in structure if symbol not in {*COLUMN, "R"}]


def has_time(symbol: str) -> bool:
    """Whether a term has a time as its second parameter."""
    return len(TERMS[symbol].parameters()) > 1


def models_of(
    structures: Sequence[Structure],
    names: Sequence[str],
    *,
    poles: int | Sequence[int] = 0,
    room_poles: int | None = None,
    shortest: float = SHORTEST_GIVEN,
) -> Models:
    """Return one model for each structure, with all of the regressors `names`.

    The ramp ``R`` is only in structures that contain it. `poles` are equal for all models or given
    for each.
    """
    count = len(structures)
    most = {symbol: max((own.count(symbol) for own in structures), default=0) for symbol in TERMS}
    slots = (*COLUMN, *(symbol for symbol in shaped_symbols(most) for _ in range(most[symbol])))
    rank = [slots[:at].count(symbol) for at, symbol in enumerate(slots)]
    has = [[own.count(s) > before for s, before in zip(slots, rank, strict=True)] for own in structures]
    own = [[name != "R" or name in structure for name in names] for structure in structures]
    return Models(
        slots=slots,
        has=np.array(has, dtype=bool).reshape(count, len(slots)),
        poles=np.broadcast_to(np.asarray(poles, dtype=np.int64), count),
        regressors=np.array(own, dtype=bool).reshape(count, len(names)),
        names=tuple(names),
        room_poles=int(np.max(poles)) if room_poles is None else room_poles,
        shortest=shortest,
    )


def all_structures(max_gm: int, *, method: str = "mle", quantization: bool = True) -> list[Structure]:
    """Return every sum of the terms that a method fits, except the ramp alone."""
    choices = [
        [(symbol,) * count for count in (range(max_gm + 1) if TERMS[symbol].repeatable else (1, 0))]
        for symbol in _fitted(method)
        if quantization or symbol != "Q"
    ]
    every = (tuple(symbol for part in parts for symbol in part) for parts in product(*choices))
    return [structure for structure in every if structure not in {(), ("R",)}]


def richest(structure: Structure | None, max_gm: int = 1) -> Structure:
    """Return a structure that contains every candidate; for a given one, its terms and the slow terms."""
    if structure is None:
        counts = {symbol: max(max_gm, 1) if TERMS[symbol].repeatable else 1 for symbol in _fitted("mle")}
        return tuple(symbol for symbol, count in counts.items() for _ in range(count))
    return in_order((*structure, *{*ALWAYS, GaussMarkov.symbol}.difference(structure)))


def _fitted(method: str) -> list[str]:
    return [symbol for symbol, term in TERMS.items() if method in term.fitted_by]
