"""What is known of a gyroscope's scale and misalignment before any turn, and which entries the turns show."""

from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import BoolArray, FloatArray, ReadOnlyArrays
from imucal.calibration.accelerometer import MISALIGNMENT

__all__ = ["GyroPrior"]

#: Standard deviation of a scale error before any turn: datasheets of consumer IMUs give 1 to 3 %.
_SCALE = 0.02
#: An entry of C is not observable if its deviation is more than this share of the one before any turn.
_DOMINATES = 0.4
#: Below this share the turns show an entry, and its prior, which would draw it by 6 %, is dropped.
_MATTERS = 0.25
_DIAGONAL = np.eye(3, dtype=np.bool_).ravel()
_DEVIATIONS = np.where(_DIAGONAL, _SCALE, MISALIGNMENT)


@dataclass(frozen=True, kw_only=True, eq=False)
class GyroPrior(ReadOnlyArrays):
    """The prior of C by rows: the identity if `si`, otherwise a multiple of it of unknown size.

    Entries that are not `free`, shape (9,), stay at the prior mean and count as noise. Only entries
    `with_prior` are drawn to it.
    """

    si: bool
    free: BoolArray
    with_prior: BoolArray

    @classmethod
    def of(cls, start: FloatArray) -> "GyroPrior":
        """Return the prior of a fit that starts at `start`."""
        every = np.ones(9, dtype=np.bool_)
        return cls(si=bool(np.array_equal(start, np.eye(3))), free=every, with_prior=every)

    @property
    def basis(self) -> FloatArray:
        """Derivatives of C in the q parameters that are fitted, shape (9, q)."""
        columns = np.eye(9)[:, self.free]
        fixed_scales = (_DIAGONAL & ~self.free).astype(np.float64)
        if self.si or not fixed_scales.any():
            return np.asarray(columns)
        # Scales of raw counts that the turns do not show share the unknown scale.
        return np.column_stack([columns, fixed_scales])

    def rows(self, C: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the k differences from the prior mean in deviations, and their derivatives in C, (k, 9)."""
        common = 1.0 if self.si else float(np.trace(C)) / 3
        slopes = np.eye(9)
        mean = np.eye(3).ravel() if self.si else np.zeros(9)
        if not self.si:
            slopes -= np.outer(_DIAGONAL, _DIAGONAL) / 3
        slopes = slopes[self.with_prior] / (common * _DEVIATIONS[self.with_prior])[:, None]
        return slopes @ (C.ravel() - mean), slopes

    def fixed_deviation(self, C: FloatArray) -> FloatArray:
        """Return the deviation of each entry that is not free, 0 for free ones, shape (9,)."""
        return np.asarray(self._deviation(C) * ~self.free)

    def after(self, C: FloatArray, covariance: FloatArray) -> "GyroPrior":
        """Return the prior after a fit, the same one if nothing changes.

        Entries that the turns do not show are fixed. If there are none, those that they show lose it.
        """
        shares = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / self._deviation(C)
        unseen = self.with_prior & self.free & (shares > _DOMINATES)
        if unseen.any():
            return replace(
                self, free=self.free & ~unseen, with_prior=self.with_prior & ~(unseen & self._fixable)
            )
        clear = self.with_prior & (shares < _MATTERS)
        scales = _DIAGONAL & self.with_prior
        if not self.si and not clear[_DIAGONAL].all():
            # The scales of raw counts are known by their differences only.
            clear &= ~scales
        return replace(self, with_prior=self.with_prior & ~clear) if clear.any() else self

    @property
    def _fixable(self) -> BoolArray:
        """Entries whose prior is not needed once they are fixed."""
        return np.ones(9, dtype=np.bool_) if self.si else ~_DIAGONAL

    def _deviation(self, C: FloatArray) -> FloatArray:
        common = 1.0 if self.si else float(np.trace(C)) / 3
        return np.asarray(common * _DEVIATIONS)
