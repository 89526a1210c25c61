"""Bins: the data from which the likelihood of one axis can be evaluated again without the samples.

`pack` stores them in a few kilobytes, for archives of thousands of logs. Its rounding errors are far below
the statistical errors. A bin's power is a chi-squared variable, so its logarithm is rounded to a small
share of its standard deviation. A product with a regressor is rounded to a small share of the square root
of both squares. The rounded integers share many high bytes, so they compress well. The regressors are
subtracted first, with coefficients that are stored exactly: otherwise the rounding of a strong trend would
exceed the noise.
"""

import struct
import zlib
from dataclasses import dataclass, replace

import numpy as np

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays
from imucal.errors import DataError
from imucal.frozen import frozen_alone

#: Version of the layout of `Bins`; increase it if an old reader would misread the new layout.
BINS_VERSION = 1


@frozen_alone
class Bins(ReadOnlyArrays):
    """The binned DCT ordinates of an axis: sums of squares, and of products with the regressors.

    The samples form k unbroken blocks of lengths `n`, shape (k,). The b bins of all blocks follow each other;
    `start`, shape (k,), is the index of each block's first bin. A bin begins with the ordinate `first`, shape
    (b,), and ends where the next bin of its block begins; the last one ends at the ordinate n - 1. It has
    `size` degrees of freedom and a `power`, the sum of its squared ordinates in units of `scale`², shape (b,)
    each.

    `names` are the regressors: ``R`` first, then the shapes that the fit of this axis took out. `cross`,
    shape (r, b), are sums of ordinate times regressor's ordinate, in units of `scale`. `gram`, shape
    (r, r, b), are sums of products of regressors' ordinates. `scale` is U per scaled unit, a power of two and
    so exact. `tau0` is the sampling period in s. `widening`, at least 1, is the factor by which heavy tails
    widen the interval of N. `version` is the layout's version. The arrays take about 8 (3 + r + r²) b bytes:
    24 kB for 10⁵ samples (b = 590) and one ramp.
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
PACKED_VERSION = 1
#: Rounding steps per standard deviation of a bin's logarithm; per unit of correlation with a lone ramp; per
#: unit of correlation if there are more regressors (maybe collinear), and of a regressor's log square.
_DEVIATION, _CORRELATION, _EXACT = 2.0**21, 2.0**15, 2.0**26
#: Rounds of weighted least squares for the reference; number of bins averaged for a weight.
_ROUNDS, _SMOOTH = 4, 9
#: Versions of both formats; numbers of blocks, regressors, bins, bytes of names; scale, tau0, widening.
_HEAD = struct.Struct("<BBHHIIddd")


def pack(bins: Bins) -> bytes:
    """Return bins as bytes: 3.3 kB for 10⁵ samples.

    Each product that involves a regressor other than the ramp adds as much. Results of `imucal.pool` change
    by less than 1e-6 of their value.
    """
    reference = _reference(bins)
    rest, left = _less(bins.power, bins.cross, bins.gram, reference)
    names = "\n".join(bins.names).encode()
    exact = (names, bins.n.astype("<i8"), bins.start.astype("<i8"), reference)
    stream = _Stream(bytearray().join(bytes(part) for part in exact))
    _through(stream, replace(bins, power=np.maximum(rest, 1e-12 * bins.power), cross=left))
    head = _HEAD.pack(
        *(PACKED_VERSION, bins.version, bins.n.size, len(bins.names), bins.first.size, len(names)),
        *(bins.scale, bins.tau0, bins.widening),
    )
    return head + zlib.compress(stream.data, 9)


def unpack(data: bytes) -> Bins:
    """Return the bins that `pack` stored; raise a DataError for another version or damaged bytes."""
    if data[:2] != bytes([PACKED_VERSION, BINS_VERSION]):
        found = ".".join(map(str, data[:2])) or "no bytes"
        msg = (
            f"packed bins: found version {found}, expected {PACKED_VERSION}.{BINS_VERSION}; fit the log again"
        )
        raise DataError(msg)
    try:
        _, version, blocks, regressors, total, letters, scale, tau0, widening = _HEAD.unpack_from(data)
        stream = _Stream(bytearray(zlib.decompress(data[_HEAD.size :])), place=0)
        names = tuple(stream.take(letters).decode().split("\n"))
        n, start = (np.frombuffer(stream.take(8 * blocks), "<i8").astype(np.int64) for _ in range(2))
        reference = np.frombuffer(stream.take(8 * regressors), "<f8")
        blank = Bins(
            n=n,
            start=start,
            first=np.zeros(total, dtype=np.int64),
            size=np.zeros(total),
            power=np.zeros(total),
            names=names,
            cross=np.zeros((regressors, total)),
            gram=np.zeros((regressors, regressors, total)),
            scale=scale,
            tau0=tau0,
            widening=widening,
            version=version,
        )
        passed = _through(stream, blank)
    except (struct.error, zlib.error, ValueError, IndexError) as error:
        msg = f"packed bins: found damaged bytes ({error}), expected the bins of a fit; fit the log again"
        raise DataError(msg) from error
    power, cross = _less(passed.power, passed.cross, passed.gram, -reference)
    return replace(passed, power=power, cross=cross)


def _through(stream: "_Stream", bins: Bins) -> Bins:
    """Write the columns of bins, or read columns of the same shape; return the bins of the stream."""
    first = np.cumsum(np.cumsum(stream.integers(np.diff(bins.first, n=2, prepend=(0, 0)))))
    count = _counts(bins.n, bins.start, first)
    fine = _DEVIATION * np.sqrt(count / 2)
    size, power = (count * stream.logarithms(own / count, fine) for own in (bins.size, bins.power))
    gram, cross = bins.gram.copy(), bins.cross.copy()
    steps = _CORRELATION if len(bins.names) == 1 else _EXACT
    for i, law in enumerate(_laws(bins.names, bins.n, bins.start, first, count)):
        gram[i, i] = law * stream.logarithms(gram[i, i] / law, _EXACT, rise=True)
        for j in range(i):
            products = stream.correlations(gram[i, j], gram[i, i] * gram[j, j], _EXACT)
            gram[i, j] = gram[j, i] = products
        cross[i] = stream.correlations(cross[i], power * gram[i, i], steps)
    return replace(bins, first=first, size=size, power=power, gram=gram, cross=cross)


def _less(
    power: FloatArray, cross: FloatArray, gram: FloatArray, beta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return power and products after subtracting `beta`, shape (r,), times the regressors."""
    rest: FloatArray = power - 2 * beta @ cross + np.einsum("i,ijb,j->b", beta, gram, beta)
    return rest, cross - np.einsum("ijb,j->ib", gram, beta)


def _counts(n: IntArray, start: IntArray, first: IntArray) -> FloatArray:
    """Return how many ordinates each bin spans, shape (b,)."""
    ends = np.append(first[1:], 0)
    ends[np.append(start[1:], first.size) - 1] = n
    return np.asarray((ends - first).astype(np.float64))


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


def _laws(
    names: tuple[str, ...], n: IntArray, start: IntArray, first: IntArray, count: FloatArray
) -> FloatArray:
    """Return the expected shape of the regressors' squares, shape (r, b): 1 except for the ramp."""
    laws = np.ones((len(names), first.size))
    if names[0] == "R":
        length = np.repeat(n, np.diff(start, append=first.size)).astype(np.float64)
        law = _ramp(length, first, count)
        laws[0] = np.where(law > 0, law, 1.0)
    return laws


def _ramp(n: FloatArray, first: IntArray, count: FloatArray) -> FloatArray:
    """Return the sums of the squared ordinates cos²/sin⁴ (πk/2n), of odd k, of a ramp in n samples.

    A bin of several ordinates uses the integral with the first correction of the midpoint rule.
    """
    last = first + count - 1
    low, high = (np.pi * edge / (2 * n) for edge in (first - first % 2, last + last % 2))
    step = np.pi / n
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = []
        for sine, cosine in ((np.sin(x), np.cos(x)) for x in (low, high)):
            slope = -2 * cosine / sine**3 - 4 * cosine**3 / sine**5
            ends.append((cosine / sine) ** 3 / 3 + step**2 / 24 * slope)
        single = np.cos(np.pi * first / (2 * n)) ** 2 / np.sin(np.pi * first / (2 * n)) ** 4
        return np.where(count == 1, np.where(first % 2 == 1, single, 0.0), (ends[0] - ends[1]) / step)


@dataclass(slots=True)
class _Stream:
    """Columns of numbers in sequence: written to `data`, or read from it if `place` is given.

    Each method takes the numbers to write, or an array of the size to read, and returns the column's numbers.
    """

    data: bytearray
    place: int | None = None

    def take(self, size: int) -> bytearray:
        """Return the next bytes."""
        start = self.place or 0
        self.place = start + size
        if self.place > len(self.data):
            raise ValueError("too few")
        return self.data[start : self.place]

    def integers(self, codes: IntArray) -> IntArray:
        """Pass integers as the number of byte planes, then the planes, low bytes first."""
        if self.place is None:
            folded = (codes << 1) ^ (codes >> 63)
            planes = (int(folded.max(initial=0)).bit_length() + 7) // 8
            self.data.append(planes)
            self.data += folded.astype("<u8").view(np.uint8).reshape(-1, 8)[:, :planes].T.tobytes()
            return codes
        planes, size = self.take(1)[0], codes.size
        table = np.zeros((size, 8), dtype=np.uint8)
        table[:, :planes] = np.frombuffer(self.take(planes * size), np.uint8).reshape(planes, size).T
        folded = table.reshape(-1).view("<u8")
        return np.asarray((folded >> 1).astype(np.int64) ^ -(folded & 1).astype(np.int64))

    def logarithms(self, values: FloatArray, steps: FloatArray | float, *, rise: bool = False) -> FloatArray:
        """Pass logarithms in `steps`, or their differences if `rise`, and a mask of the positive values."""
        size = values.size
        if self.place is None:
            told = values > 0
            self.data += np.packbits(told).tobytes()
            codes = np.rint(np.log(np.where(told, values, 1.0)) * steps).astype(np.int64)[told]
            self.integers(np.diff(codes, prepend=0) if rise else codes)
            return values
        told = np.unpackbits(np.frombuffer(self.take((size + 7) // 8), np.uint8), count=size).astype(bool)
        codes = self.integers(np.zeros(np.count_nonzero(told), dtype=np.int64))
        result = np.zeros(size)
        result[told] = np.exp((np.cumsum(codes) if rise else codes) / np.broadcast_to(steps, size)[told])
        return result

    def correlations(self, products: FloatArray, squares: FloatArray, steps: float) -> FloatArray:
        """Pass products divided by the root of `squares`, in `steps`."""
        root = np.sqrt(squares)
        part = np.divide(products, root, out=np.zeros_like(root), where=root > 0)
        codes = self.integers(np.rint(np.clip(part, -1, 1) * steps).astype(np.int64))
        result: FloatArray = codes / steps * root
        return products if self.place is None else result
