"""Structures, such as ("N", "B", "K"), and the candidates made of them."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from imucal.fitting.spectral.likelihood import Candidates
from imucal.fitting.spectral.ordinates import LAWS
from imucal.noise.terms import GaussMarkov, in_order, term_keys

#: Symbols of a model's terms in the order of `imucal.noise.TERMS`, GM once for each.
Structure = tuple[str, ...]

#: Shortest correlation time that `auto` takes for a Gauss-Markov term, in samples; what is
#: shorter is the sensor's output filter.
SHORTEST = 10.0
#: Shortest of a given model.
SHORTEST_GIVEN = 2.0

_SYMBOLS = tuple(law.value for law in LAWS)


def all_structures(max_gm: int, *, quantization: bool = True) -> list[Structure]:
    """Return every sum of Q, N, B, K, R and up to `max_gm` GM that has noise in it."""
    found = []
    for q, n, b, k, gm, r in product(
        (True, False) if quantization else (False,),
        (True, False),
        (True, False),
        (True, False),
        range(max_gm + 1),
        (True, False),
    ):
        structure = ("Q",) * q + ("N",) * n + ("B",) * b + ("GM",) * gm + ("K",) * k + ("R",) * r
        if structure not in {(), ("R",)}:
            found.append(structure)
    return found


def richest(structure: Structure | None, max_gm: int) -> Structure:
    """Return a structure that holds every candidate."""
    if structure is None:
        return ("Q", "N", "B", *["GM"] * max(max_gm, 1), "K", "R")
    return in_order((*structure, *(s for s in ("N", "B", "GM", "K") if s not in structure)))


def candidates_of(
    structures: Sequence[Structure],
    names: Sequence[str],
    *,
    poles: int | Sequence[int] = 0,
    zeros: int | Sequence[int] = 0,
    common: Sequence[str] = (),
    room_markov: int | None = None,
    room_poles: int | None = None,
) -> Candidates:
    """Return one candidate for each structure.

    Parameters
    ----------
    names
        The ordinates' regressors.
    poles, zeros
        Order of the output filter's response, one for all or one for each.
    common
        Regressors that every candidate has.
    room_markov, room_poles
        Columns kept for each; no more than needed by default.
    """
    count = len(structures)
    markov = np.array([structure.count("GM") for structure in structures], dtype=np.int64)
    return Candidates(
        laws=np.array([[s in own for s in _SYMBOLS] for own in structures]).reshape(count, len(_SYMBOLS)),
        markov=markov,
        poles=np.broadcast_to(np.asarray(poles, dtype=np.int64), count),
        zeros=np.broadcast_to(np.asarray(zeros, dtype=np.int64), count),
        regressors=np.array(
            [[name in structure or name in common for name in names] for structure in structures]
        ).reshape(count, len(names)),
        room_markov=int(markov.max(initial=0)) if room_markov is None else room_markov,
        room_poles=int(np.max(poles)) if room_poles is None else room_poles,
    )


def parameter_columns(structure: Structure, room_markov: int) -> list[tuple[str, int]]:
    """Return name and column of each of a structure's parameters but R, such as ("GM1.T", 5).

    One Gauss-Markov term is called ``GM``, several ``GM1``, ``GM2`` …
    """
    columns = [(s, _SYMBOLS.index(s)) for s in structure if s in _SYMBOLS]
    markov = [key for key, s in zip(term_keys(structure), structure, strict=True) if s == "GM"]
    first = len(_SYMBOLS)
    for index, key in enumerate(markov):
        sigma, time = GaussMarkov.parameter_names(key)
        columns += [(sigma, first + index), (time, first + room_markov + index)]
    return columns
