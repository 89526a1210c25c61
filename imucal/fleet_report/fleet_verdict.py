"""What matters of a fleet in one sentence: which units are odd, and how many logs do not count."""

from collections.abc import Sequence

import numpy as np

from imucal.fleet.population import FALSE_SHARE, adjusted
from imucal.fleet_report.shown import loose_text
from imucal.fleet_report.summary import Fleet, FleetTerm


def verdict(fleet: Fleet) -> tuple[str, str]:
    """Return the grade of a fleet and one sentence: which units are odd, and how many logs do not count."""
    said, chance = _strange(fleet)
    failed = sum(len(logs) for logs in fleet.failures.values())
    if failed:
        said.append(f"{failed} of {len(fleet.logs)} logs do{'es' * (failed == 1)} not count")
    if fleet.loose:
        said.append(loose_text(fleet))
    few = [model.title for model in fleet.models if len(model.units) < 3]
    if few:
        said.append(f"{', '.join(few)}: too few units to tell a spread or a bound")
    grade, text = ("look", "; ".join(said)) if said else ("good", "no unit is odd, and every log counts")
    if chance:
        text += f"; far off in one term of so many, perhaps by chance: {'; '.join(chance)}"
    # A model's name stays as it is.
    named = any(text.startswith((f"{model.title}:", f"{model.title},")) for model in fleet.models)
    return grade, f"{text if named else text[0].upper() + text[1:]}."


def _strange(fleet: Fleet) -> tuple[list[str], list[str]]:
    """Return which units of each model are odd or move otherwise, and which may be odd by chance."""
    several = len(fleet.models) > 1
    sure = beyond_chance(fleet)
    said: list[str] = []
    chance: list[str] = []
    for model in fleet.models:
        title = f"{model.title}: " if several else ""
        odd = [(unit.unit, term) for term in model.terms for unit in term.odd]
        if surely := [(unit, term) for unit, term in odd if (id(term), unit) in sure]:
            said.append(f"{title}odd {_listed(surely, 'unit')}")
        if perhaps := [(unit, term) for unit, term in odd if (id(term), unit) not in sure]:
            chance.append(f"{title}{_listed(perhaps)}")
        if moving := [(unit, term) for term in model.terms for unit in term.drifting]:
            said.append(f"{title}moving with time or temperature as no other: {_listed(moving)}")
    return said, chance


def beyond_chance(fleet: Fleet) -> set[tuple[int, str]]:
    """Return the terms, by identity, and units that are odd among all units of all terms together.

    Each term has its false alarms, of which a fleet with many terms has some.
    """
    tested = [
        (id(term), unit.unit, unit.p_value)
        for model in fleet.models
        for term in model.terms
        for unit in term.population.units
        if unit.p_value is not None
    ]
    p_values = adjusted(np.array([p for *_, p in tested]))
    return {
        (term, unit) for (term, unit, _), p in zip(tested, p_values.tolist(), strict=True) if p <= FALSE_SHARE
    }


def _listed(places: Sequence[tuple[str, FleetTerm]], noun: str = "") -> str:
    """Return ``units u07 (gyro_z N); u11 (gyro_x B, gyro_x K)``."""
    terms: dict[str, list[str]] = {}
    for unit, term in places:
        terms.setdefault(unit, []).append(f"{term.name} {term.term}")
    listed = "; ".join(f"{unit} ({', '.join(where)})" for unit, where in terms.items())
    return f"{noun}{'s' * (len(terms) > 1)} {listed}" if noun else listed
