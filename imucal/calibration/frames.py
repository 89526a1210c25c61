"""The frame of a calibrated IMU: gravity at rest does not show its rotation, so a convention fixes it."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from imucal.arrays import FloatArray, ReadOnlyArrays
from imucal.calibration.accelerometer import LOWER

__all__ = ["FRAMES", "LOWER_SLOPES", "Frame", "rotation_to"]

#: Name of a frame -> its definition.
FRAMES = {
    "kalibr": "x along the accelerometer's x axis, y in its x-y plane",
    "imu-tk": "z along the accelerometer's z axis, y in its y-z plane",
    "nearest": "as near as possible to all three axes of the accelerometer",
}
#: Derivatives of C by each element of its lower triangle, shape (3, 3, 6).
LOWER_SLOPES = np.stack(
    [np.outer(np.eye(3)[row], np.eye(3)[column]) for row, column in zip(*LOWER, strict=True)], axis=-1
)
#: Relative step of a central difference: its error is about 1e-10.
_STEP = 1e-6


def rotation_to(frame: str, C: FloatArray) -> FloatArray:
    """Return R, shape (3, 3): R f is in the frame if f = C (raw - b), in any other frame.

    M Rᵀ is lower triangular (``kalibr``), upper triangular (``imu-tk``), or symmetric after each row is
    divided by its length (``nearest``).
    """
    M = np.linalg.inv(C)
    axes = M / np.linalg.norm(M, axis=1)[:, None]
    if frame == "nearest":
        U, _, V = np.linalg.svd(axes)
        return np.asarray(U @ V)
    # The triangle of the reversed axes is the other one.
    order = slice(None, None, -1 if frame == "imu-tk" else 1)
    Q, R = np.linalg.qr(axes[order].T)
    return np.asarray((Q * np.sign(np.diag(R))).T[order])


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame(ReadOnlyArrays):
    """A frame of one accelerometer; `name` is a key of `FRAMES`.

    R is the rotation from the frame of the fit, whose C is lower triangular. `slopes`, shape (3, 3, 6), are
    Rᵀ d(R C): derivatives of R C in the lower triangle of C, turned back.
    """

    name: str
    R: FloatArray
    slopes: FloatArray

    @classmethod
    def of(cls, name: str, C: FloatArray) -> "Frame":
        R, slopes = rotation_to(name, C), np.empty((3, 3, 6))
        for k, (i, j) in enumerate(zip(*LOWER, strict=True)):
            step = np.zeros((3, 3))
            step[i, j] = _STEP * C[j, j]
            high, low = (rotation_to(name, moved) @ moved for moved in (C + step, C - step))
            slopes[:, :, k] = R.T @ (high - low) / (2 * step[i, j])
        return cls(name=name, R=R, slopes=slopes)

    @property
    def derivatives(self) -> FloatArray:
        """Derivatives of R C in the lower triangle of C."""
        return np.asarray(np.einsum("ij,jkl->ikl", self.R, self.slopes))

    @property
    def entries(self) -> list[tuple[int, int]]:
        """The six entries of R C that define it, in the order of every covariance."""
        lower = [(i, j) for i, j in product(range(3), repeat=2) if i >= j]
        return [(j, i) for i, j in lower] if self.name == "imu-tk" else lower

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the accelerometer's parameters, in the order of `entries`, then biases."""
        kinds = (
            f"scale_{'xyz'[i]}" if i == j else f"misalignment_{'xyz'[i]}{'xyz'[j]}" for i, j in self.entries
        )
        return (*kinds, "bias_x", "bias_y", "bias_z")
