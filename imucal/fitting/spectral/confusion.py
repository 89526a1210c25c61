"""Which models a record does not tell apart, in words."""

from imucal.findings import Finding
from imucal.fitting.noise_fit import Candidate
from imucal.fitting.spectral.selection import Choice
from imucal.noise.model import structure_text

#: Models whose criterion is within this of the best are listed.
_NEAR = 6.0
#: Twice the log-likelihood below which a second maximum is as good as the first.
_MODES = 4.0


def near_candidates(choice: Choice) -> tuple[Candidate, ...]:
    """Return the models within reach of the best, the best first."""
    delta = choice.criterion - choice.criterion[0]
    return tuple(
        Candidate(structure=structure_text(structure), delta=float(d))
        for structure, d in zip(choice.structures, delta, strict=True)
        if d <= _NEAR
    )


def choice_findings(choice: Choice, axis: str) -> tuple[Finding, ...]:
    """Say which models do as well, what they differ in, and whether the best has two maxima."""
    near = near_candidates(choice)
    findings = []
    if len(near) > 1:
        others = ", ".join(f"{c.structure} (+{c.delta:.1f})" for c in near[1:])
        text = (
            f"The record does not tell {near[0].structure} from {others}: {_difference(choice, len(near))}."
        )
        findings.append(
            Finding(
                level="info",
                code="model-choice",
                axis=axis,
                text=text,
                advice="Record for longer, or give the model if it is known.",
            )
        )
    if choice.modes[0] < _MODES / 2:
        findings.append(
            Finding(
                level="warning",
                code="two-maxima",
                axis=axis,
                text=f"{near[0].structure} explains the record in two ways about as well; "
                "the better one is reported, and its intervals do not cover the other.",
                advice="Record for longer, or give a simpler model.",
            )
        )
    return tuple(findings)


def _difference(choice: Choice, count: int) -> str:
    """Return which terms are in some of the near models only, in words."""
    sets = [set(structure) for structure in choice.structures[:count]]
    numbers = [structure.count("GM") for structure in choice.structures[:count]]
    unsure = sorted({s for one in sets for s in one if not all(s in other for other in sets)})
    if not unsure:
        return f"between {min(numbers)} and {max(numbers)} GM terms"
    if len(unsure) == 1:
        return f"{unsure[0]} may or may not be there"
    return f"{', '.join(unsure[:-1])} and {unsure[-1]} may stand for one another"
