"""What to know before the figures of a part are used: how they are defined, and what is missing."""

from collections.abc import Iterator

from imucal.noise.terms import TERMS
from imucal.sensors.part import WALK_SPREAD, Part

__all__ = ["cautions"]

_CONFIDENCE = {
    "manufacturer": "",
    "manufacturer front page": "Only the front page of the data sheet was available.",
    "secondary": "These figures are quoted by somebody else. Look them up in the data sheet before you "
    "rely on them.",
    "software default": "These figures are parameters of the manufacturer's software. They may be rounded.",
}
#: Printed figures that are a random walk.
_WALKS = ("angle_random_walk", "velocity_random_walk")
_TYPICAL = "Typical values are no limits: real units have half to twice the typical N."


def cautions(part: Part) -> tuple[str, ...]:
    """Return sentences about the figures of a part, its own note first."""
    found = [part.note, _CONFIDENCE[part.confidence], *_of_walks(part), *_of_densities(part)]
    found += [*_of_maxima(part), *_of_biases(part)]
    if any(term.kind == "typical" for term in part.terms):
        found.append(_TYPICAL)
    found.append(_of_walks_of_the_bias(part))
    return tuple(filter(None, found))


def _of_walks_of_the_bias(part: Part) -> str:
    """Return a sentence about the missing K, empty if it is printed."""
    missing = [sensor for sensor in part.sensors if part.term(sensor, "K") is None]
    if not missing:
        return ""
    walks = [
        f"{walk:g} {TERMS['K'].unit(sensor)}" for sensor in missing if (walk := part.typical_walk(sensor))
    ]
    if not walks:
        return "No K is printed."
    return (
        f"No K is printed. The median of measured MEMS sensors is {' and '.join(walks)}, and they differ "
        f"from it by up to a factor of {WALK_SPREAD}."
    )


def _of_walks(part: Part) -> Iterator[str]:
    """Yield a sentence if both a random walk and a larger density are printed."""
    ratios = []
    for sensor, own in part.sensors.items():
        walk = next((own.figures[key] for key in _WALKS if key in own.figures), None)
        density = own.figures.get("noise_density")
        if walk and density and walk.si and density.si:
            ratios.append(f"{density.si / walk.si:.2f} times ({sensor})")
    if ratios:
        yield (
            f"The density is {' and '.join(ratios)} the random walk. N is the random walk, because the Allan "
            "deviation shows it at 1 s."
        )


def _of_densities(part: Part) -> Iterator[str]:
    """Yield a sentence if N is a density at one frequency."""
    names = []
    for sensor, own in part.sensors.items():
        white = own.terms.get("N")
        if white is None or white.origin != "noise_density" or white.alternative is not None:
            continue
        if "10 Hz" in own.figures["noise_density"].condition.replace("10Hz", "10 Hz"):
            names.append(str(sensor))
    if names:
        yield f"The density of the {' and the '.join(names)} is for 10 Hz; slower noise may be larger."


def _of_maxima(part: Part) -> Iterator[str]:
    for term in part.terms:
        if term.kind == "maximum":
            yield f"{term.symbol} of the {term.sensor} is a maximum, not a typical value."


def _of_biases(part: Part) -> Iterator[str]:
    """Yield a sentence about each definition of a bias instability other than the Allan minimum."""
    for sensor, own in part.sensors.items():
        if "bias_instability" in own.figures and "B" not in own.terms:
            yield f"The bias of the {sensor} is no minimum of an Allan deviation, so it gives no B."
    definitions = [own.floor.definition for own in part.sensors.values() if own.floor is not None]
    for definition in dict.fromkeys(definitions):
        if "minimum" not in definition:
            yield (
                f"The bias instability ({definition}) is taken as the minimum of the Allan deviation: B is "
                "1/0.664 of it."
            )
