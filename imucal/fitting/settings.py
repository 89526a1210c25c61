"""FitSettings: the checked settings of a fit; and the table of methods."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Transform
from imucal.arrays import FloatArray
from imucal.errors import ArgumentError
from imucal.fitting.noise_fit import NoiseFit
from imucal.noise.model import parse_structure
from imucal.noise.terms import require_fittable
from imucal.recording import AxisSeries

#: Method -> module and function of the fit; the module is imported when it is used.
METHODS: dict[str, tuple[str, str]] = {
    "mle": ("imucal.fitting.spectral", "fit_mle"),
    "gmwm": ("imucal.fitting.moments", "fit_gmwm"),
    "slope": ("imucal.fitting.moments", "fit_slope"),
}

#: Criterion of the choice between models -> price of one parameter for a number of samples, in units of twice
#: the log-likelihood, or of the weighted sum of squares. Source: Wilks (1938), Annals of Mathematical
#: Statistics 9 (chance); Schwarz (1978), Annals of Statistics 6 (bic); Hannan & Quinn (1979), JRSS B 41 (hq);
#: Akaike (1974), IEEE TAC 19 (aic).
CRITERIA: dict[str, Callable[[float], float]] = {
    "chance": lambda _: 12.0,
    "bic": lambda count: float(np.log(count)),
    "hq": lambda count: float(2 * np.log(np.log(max(count, 3)))),
    "aic": lambda _: 2.0,
}

#: Largest number of segments of a record.
MAX_SEGMENTS = 64

#: Weights of gmwm: full covariance, or the published diagonal.
WEIGHTS = ("full", "eta3")


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """The settings of a fit, explained at `imucal.fit`; wrong ones raise a ValueError."""

    model: str = "auto"
    method: str = "mle"
    level: float = 0.95
    criterion: str = "chance"
    weights: str = "full"
    max_gm: int = 2
    clean: bool = True
    segments: int = 8

    def __post_init__(self) -> None:
        choices = (
            ("method", self.method, METHODS),
            ("criterion", self.criterion, CRITERIA),
            ("weights", self.weights, WEIGHTS),
        )
        for name, value, known in choices:
            if value not in known:
                raise ArgumentError(f"{name} {value!r} is not one of {', '.join(known)}")
        if not 0 < self.level < 1:
            raise ArgumentError(f"level must be between 0 and 1, got {self.level}")
        if not 0 <= self.max_gm <= 2:
            raise ArgumentError(f"max_gm must be 0, 1 or 2, got {self.max_gm}")
        if not 1 <= self.segments <= MAX_SEGMENTS:
            msg = f"segments must be from 1 (not compared) to {MAX_SEGMENTS}, got {self.segments}"
            raise ArgumentError(msg)
        require_fittable(self.structure or (), self.method)

    @property
    def structure(self) -> tuple[str, ...] | None:
        """Symbols of the model's terms, or None if the fit chooses them."""
        return None if self.model == "auto" else parse_structure(self.model)

    @property
    def chosen_by(self) -> str:
        """The criterion, or ``given``."""
        return self.criterion if self.structure is None else "given"


#: Fits finite samples (None for a curve alone), their curve, the temperature in degrees Celsius, and the
#: transform of the samples (None computes it).
Method: TypeAlias = Callable[
    [AxisSeries | None, AllanCurve, FitSettings, FloatArray | None, Transform | None], NoiseFit
]


def load_method(name: str) -> Method:
    """Import the function of a method."""
    module, function = METHODS[name]
    return cast("Method", getattr(importlib.import_module(module), function))
