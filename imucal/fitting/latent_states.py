"""The states that a noise model's samples are the sum of, under the names of its terms."""

from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.fitting.state_space import term_states, unseen_white
from imucal.noise.model import NoiseModel
from imucal.noise.term import PowerLawTerm
from imucal.noise.terms import term_keys

#: The component that is the sum of all.
BIAS = "bias"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LatentStates:
    """The states of a model, which samples are the sum of, with white noise beside them.

    Attributes
    ----------
    decay, drive, start
        As of `imucal.fitting.state_space.StateSpace`, shape (d,).
    groups
        Key of the component -> which states it sums, shape (d,); a quantization error, where there
        is one, stands first and belongs to none.
    quantized
        Whether the first state u is a quantization error: samples hold u[t+1] - u[t].
    flat
        Names of what has no noise and a flat prior: ``level`` and ``R``, the slope.
    white
        Variance of the white noise.
    """

    decay: FloatArray
    drive: FloatArray
    start: FloatArray
    groups: dict[str, BoolArray]
    quantized: bool
    flat: tuple[str, ...]
    white: float

    @classmethod
    def of(cls, model: NoiseModel, *, rate_hz: float, n: int) -> "LatentStates":
        """Return the states of a model's terms for `n` samples.

        A walk holds the level; without one the level stands for itself.

        Raises
        ------
        ValueError
            If a term has no states.
        """
        tau0 = 1 / rate_hz
        states: list[tuple[float, float, float]] = []
        owners: list[str] = []
        variances = {t.symbol: t.variance(tau0) for t in model.terms if isinstance(t, PowerLawTerm)}
        if variances.get("Q"):
            states, owners = [(0.0, variances["Q"], variances["Q"])], [""]
        for term, key in zip(model.terms, term_keys(t.symbol for t in model.terms), strict=True):
            own = term_states(term, tau0, n)
            states += own
            owners += [key] * len(own)
        decay, drive, start = np.array(states).reshape(-1, 3).T.copy()
        flat: tuple[str, ...] = () if np.isinf(start).any() else ("level",)
        if any(term.symbol == "R" for term in model.terms):
            flat += ("R",)
        white = variances.get("N") or unseen_white(model, rate_hz, n, float(drive.max(initial=0.0)) or 1.0)
        names = [key for key in dict.fromkeys(owners) if key]
        return cls(
            decay=decay,
            drive=drive,
            start=start,
            groups={name: np.array([owner == name for owner in owners]) for name in names},
            quantized=bool(variances.get("Q")),
            flat=flat,
            white=white,
        )

    @property
    def size(self) -> int:
        """Number of states that move."""
        return self.decay.size

    @property
    def everything(self) -> BoolArray:
        """Which states are of a component, shape (d,)."""
        every = np.zeros(self.size, dtype=bool)
        for group in self.groups.values():
            every |= group
        return every

    def in_unit_of_white(self) -> "LatentStates":
        """Return the states with white noise of variance 1."""
        return replace(self, drive=self.drive / self.white, start=self.start / self.white, white=1.0)

    def extension(self, time: float) -> FloatArray:
        """Return the map from states, level and slope to a block's extended start, shape (d + 2, d + p).

        The extended start holds the states, the level in the block, and the slope.
        """
        d = self.size
        extension = np.zeros((d + 2, d + len(self.flat)))
        extension[:d, :d] = np.eye(d)
        for i, name in enumerate(self.flat):
            extension[d:, d + i] = (1.0, 0.0) if name == "level" else (time, 1.0)
        return extension
