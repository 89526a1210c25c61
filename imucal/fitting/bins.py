"""Bins: the data from which the likelihood of one axis can be evaluated again without the samples.

`pack` stores them in single precision. It subtracts the regressors first: otherwise the rounding of a strong
trend would exceed the noise.
"""

import io
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.errors import DataError
from imucal.frozen import frozen_alone

#: Version of the layout of `Bins`; increase it if an old reader would misread the new layout.
BINS_VERSION = 1


@frozen_alone
class Bins(ReadOnlyArrays):
    """The binned DCT ordinates of an axis: sums of squares, and of products with the regressors.

    The samples form unbroken blocks of k lengths `n`, shape (k,), whose bins follow each other; `start`,
    shape (k,), is the index of each block's first bin. A bin begins with the ordinate `first`, shape (b,),
    and ends where the next bin begins. It has `size` degrees of freedom and `power`, the sum of its squared
    ordinates in units of `scale`².

    `names` are those of the regressors: ``R``, then the shapes that the fit took out. `cross`, shape (r, b),
    are sums of ordinate times regressor's ordinate, and `gram`, shape (r, r, b), of regressors' products.
    `scale` is U per scaled unit. `widening` is the factor by which heavy tails widen N's interval.
    """

    n: IntArray
    start: IntArray
    first: IntArray
    size: FloatArray
    power: FloatArray
    names: tuple[str, ...]
    cross: FloatArray
    gram: FloatArray
    scale: float
    tau0: float
    widening: float = 1.0
    version: int = BINS_VERSION

    def __post_init__(self) -> None:
        bins, regressors = self.first.size, len(self.names)
        shapes = {
            "start": (self.n.size,),
            "size": (bins,),
            "power": (bins,),
            "cross": (regressors, bins),
            "gram": (regressors, regressors, bins),
        }
        wrong = [name for name, shape in shapes.items() if getattr(self, name).shape != shape]
        if wrong or not self.n.size:
            raise ValueError(f"bins: {', '.join(wrong) or 'n'} do not fit {bins} bins of {regressors} names")
        ReadOnlyArrays.__post_init__(self)


#: Version of the packed format, its first byte.
PACKED_VERSION = 2
#: Rounds of weighted least squares for the reference, which need not be exact.
_ROUNDS = 4
#: Bins averaged for a weight: a single bin of one ordinate scatters too much.
_SMOOTH = 9
#: Versions; numbers of blocks, regressors, bins, bytes of names; scale, tau0, widening.
_HEAD = struct.Struct("<BBHHIIddd")


def pack(bins: Bins) -> bytes:
    """Return bins as bytes: 7 kB for 10⁵ samples, more with regressors other than the ramp.

    Rounding changes results of `imucal.pool` by less than 1e-6 of the width of an interval.
    """
    reference = _reference(bins)
    power, cross = _less(bins.power, bins.cross, bins.gram, reference)
    names = "\n".join(bins.names).encode()
    head = _HEAD.pack(
        *(PACKED_VERSION, bins.version, bins.n.size, len(bins.names), bins.first.size, len(names)),
        *(bins.scale, bins.tau0, bins.widening),
    )
    numbers = (
        bins.size,
        np.maximum(power, 1e-12 * bins.power),
        cross,
        bins.gram[np.tril_indices(len(cross))],
    )
    columns = [_planes(values, "<i8") for values in (bins.n, bins.start, np.diff(bins.first, prepend=0))]
    columns += [reference.astype("<f8").tobytes(), *(_planes(values, "<f4") for values in numbers)]
    return head + zlib.compress(b"".join([names, *columns]), 9)


def unpack(data: bytes) -> Bins:
    """Return the bins that `pack` stored; raise a DataError for another version or damaged bytes."""
    if data[:2] != bytes([PACKED_VERSION, BINS_VERSION]):
        found = ".".join(map(str, data[:2])) or "no bytes"
        msg = (
            f"packed bins: found version {found}, expected {PACKED_VERSION}.{BINS_VERSION}; fit the log again"
        )
        raise DataError(msg)
    try:
        return _unpacked(data)
    except (struct.error, zlib.error, ValueError) as error:
        msg = f"packed bins: found damaged bytes ({error}), expected the bins of a fit; fit the log again"
        raise DataError(msg) from error


def _unpacked(data: bytes) -> Bins:
    _, version, blocks, count, total, letters, scale, tau0, widening = _HEAD.unpack_from(data)
    stream = io.BytesIO(zlib.decompress(data[_HEAD.size :]))
    names = tuple(stream.read(letters).decode().split("\n"))
    n, start, steps = (_numbers(stream, "<i8", size) for size in (blocks, blocks, total))
    reference = np.frombuffer(stream.read(8 * count), "<f8")
    size, power = (_numbers(stream, "<f4", total).astype(np.float64) for _ in range(2))
    cross = _numbers(stream, "<f4", count * total).astype(np.float64).reshape(count, total)
    gram, (i, j) = np.zeros((count, count, total)), np.tril_indices(count)
    gram[i, j] = gram[j, i] = _numbers(stream, "<f4", i.size * total).reshape(-1, total)
    power, cross = _less(power, cross, gram, -reference)
    return Bins(
        n=n,
        start=start,
        first=np.cumsum(steps),
        size=size,
        power=power,
        names=names,
        cross=cross,
        gram=gram,
        scale=scale,
        tau0=tau0,
        widening=widening,
        version=version,
    )


def _planes(values: FloatArray | IntArray, kind: str) -> bytes:
    """Return the first bytes of all numbers, then the second ones …: similar bytes compress well."""
    flat = np.ascontiguousarray(values, dtype=kind).reshape(-1)
    return flat.view(np.uint8).reshape(flat.size, -1).T.tobytes()


def _numbers(stream: io.BytesIO, kind: str, count: int) -> NDArray[Any]:
    width = np.dtype(kind).itemsize
    planes = np.frombuffer(stream.read(width * count), np.uint8).reshape(width, count)
    return np.ascontiguousarray(planes.T).reshape(-1).view(kind)


def _less(
    power: FloatArray, cross: FloatArray, gram: FloatArray, beta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return power and products after subtracting `beta`, shape (r,), times the regressors."""
    rest: FloatArray = power - 2 * beta @ cross + np.einsum("i,ijb,j->b", beta, gram, beta)
    return rest, cross - np.einsum("ijb,j->ib", gram, beta)


def _reference(bins: Bins) -> FloatArray:
    """Return coefficients, shape (r,), that remove most of the regressors from the data."""
    beta = np.zeros(len(bins.names))
    used, smooth = bins.size > 0, np.ones(_SMOOTH)
    for _ in range(_ROUNDS):
        rest, _ = _less(bins.power, bins.cross, bins.gram, beta)
        near = np.convolve(np.maximum(rest, 0.0), smooth, "same"), np.convolve(bins.size, smooth, "same")
        weight = np.where(used, near[1], 0.0) / np.maximum(near[0], 1e-300)
        square, product = bins.gram @ weight, bins.cross @ weight
        root = np.sqrt(np.maximum(np.diag(square), 1e-300))
        beta = np.linalg.lstsq(square / np.outer(root, root), product / root, rcond=1e-10)[0] / root
    return beta
