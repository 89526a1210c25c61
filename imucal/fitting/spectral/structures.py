"""Structures, such as ("N", "B", "K"), and the candidates made of them."""

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from imucal.fitting.spectral.likelihood import Candidates
from imucal.fitting.spectral.ordinates import LAWS, SHAPED
from imucal.noise.terms import ALWAYS, TERMS, GaussMarkov, in_order, term_keys

#: Symbols of a model's terms in the order of `imucal.noise.TERMS`, one that is there twice twice.
Structure = tuple[str, ...]

#: Shortest correlation time that `auto` takes for a term, in samples; what is
#: shorter is the sensor's output filter.
SHORTEST = 10.0
#: Shortest of a given model.
SHORTEST_GIVEN = 2.0

_SYMBOLS = tuple(law.value for law in LAWS)


def shaped_symbols(structure: Iterable[str]) -> list[str]:
    """Return the symbols of the terms with a spectrum that is no power law."""
    return [symbol for symbol in structure if symbol in TERMS and symbol not in (*_SYMBOLS, "R")]


def all_structures(max_gm: int, *, quantization: bool = True) -> list[Structure]:
    """Return every sum of the terms that `mle` fits which has noise in it, each term once or not at all.

    Up to `max_gm` times those that may stand more than once.
    """
    choices = [
        [(symbol,) * count for count in (range(max_gm + 1) if TERMS[symbol].repeatable else (1, 0))]
        for symbol in _fitted()
        if quantization or symbol != "Q"
    ]
    every = (tuple(symbol for part in parts for symbol in part) for parts in product(*choices))
    return [structure for structure in every if structure not in {(), ("R",)}]


def richest(structure: Structure | None, max_gm: int) -> Structure:
    """Return a structure that holds every candidate; beside a given one, a term of any slow shape."""
    if structure is None:
        counts = {symbol: max(max_gm, 1) if TERMS[symbol].repeatable else 1 for symbol in _fitted()}
        return tuple(symbol for symbol, count in counts.items() for _ in range(count))
    return in_order((*structure, *{*ALWAYS, GaussMarkov.symbol}.difference(structure)))


def _fitted() -> list[str]:
    return [symbol for symbol, term in TERMS.items() if "mle" in term.fitted_by]


def candidates_of(
    structures: Sequence[Structure],
    names: Sequence[str],
    *,
    poles: int | Sequence[int] = 0,
    zeros: int | Sequence[int] = 0,
    common: Sequence[str] = (),
    room_shaped: int | None = None,
    room_poles: int | None = None,
) -> Candidates:
    """Return one candidate for each structure, with those of the ordinates' regressors `names` that it has.

    Every candidate has the regressors `common`. The order of the output filter's response, `poles` and
    `zeros`, is one for all or one for each. No more columns than needed are kept, or `room_shaped` for terms
    of other shapes and `room_poles` for the response.
    """
    count = len(structures)
    shaped = [shaped_symbols(structure) for structure in structures]
    kinds = in_order({symbol for own in shaped for symbol in own})
    room = max(map(len, shaped), default=0) if room_shaped is None else room_shaped
    return Candidates(
        laws=np.array([[s in own for s in _SYMBOLS] for own in structures]).reshape(count, len(_SYMBOLS)),
        shaped=np.array(
            [[*map(kinds.index, own), *[-1] * (room - len(own))] for own in shaped], dtype=np.int64
        ).reshape(count, room),
        kinds=tuple(TERMS[symbol] for symbol in kinds),
        poles=np.broadcast_to(np.asarray(poles, dtype=np.int64), count),
        zeros=np.broadcast_to(np.asarray(zeros, dtype=np.int64), count),
        regressors=np.array(
            [[name in structure or name in common for name in names] for structure in structures]
        ).reshape(count, len(names)),
        room_poles=int(np.max(poles)) if room_poles is None else room_poles,
    )


def parameter_columns(structure: Structure, room_shaped: int) -> list[tuple[str, int]]:
    """Return name and column of each of a structure's parameters but R, such as ("GM1.T", 5).

    One Gauss-Markov term is called ``GM``, several ``GM1``, ``GM2`` …
    """
    columns = [(s, _SYMBOLS.index(s)) for s in structure if s in _SYMBOLS]
    keys = [key for key, s in zip(term_keys(structure), structure, strict=True) if s not in (*_SYMBOLS, "R")]
    for index, (key, symbol) in enumerate(zip(keys, shaped_symbols(structure), strict=True)):
        places = (SHAPED + index, SHAPED + room_shaped + index)
        columns += zip(TERMS[symbol].parameter_names(key), places, strict=False)
    return columns
