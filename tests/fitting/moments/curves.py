"""Allan curves computed by the definition, for the tests of curve fits."""

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray
from imucal.noise.model import NoiseModel

__all__ = ["octave_curve", "simulated_curve"]


def octave_curve(samples: FloatArray, *, overlapping: bool = True) -> AllanCurve:
    """Return the Allan variances at m = 1, 2, 4 … n/4, sampling period 1 s, without degrees of freedom."""
    m = 2 ** np.arange(int(np.log2(samples.size / 4)) + 1)
    angle = np.concatenate([[0.0], np.cumsum(samples - samples.mean())])
    avar = []
    for factor in m.tolist():
        step = angle[2 * factor :] - 2 * angle[factor:-factor] + angle[: -2 * factor]
        step = step[:: 1 if overlapping else factor]
        avar.append(float(step @ step) / (2 * factor**2 * step.size))
    return AllanCurve(
        tau=m.astype(np.float64),
        m=m,
        avar=np.array(avar),
        edf=np.full(m.size, np.nan),
        n=samples.size,
        estimator="overlapping" if overlapping else "standard",
    )


def simulated_curve(text: str, n: int, rng: np.random.Generator) -> AllanCurve:
    """Return the curve of `n` samples of a model text, sampled at 1 Hz."""
    return octave_curve(NoiseModel.parse(text).simulate(n, rate_hz=1.0, rng=rng))
