"""The DCT-II of long records by many short transforms: without tables of the record's length.

SciPy's transform of n samples keeps 15 n bytes of sines for the next one of that length, and strides
through the whole array again and again. Split in two factors, n = rows * columns, a transform needs tables
of a factor's length, and each piece of work stays in the processor's cache.

Source: Bailey (1990), "FFTs in external or hierarchical memory", J. Supercomputing 4, 23; the DCT-II as a
real transform of the even samples, then the odd ones backwards: Makhoul (1980), IEEE Trans. ASSP 28, 27.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray, IntArray

ComplexArray: TypeAlias = NDArray[np.complex128]

#: Shorter transforms are quicker, and their tables small, in one piece.
LONG = 500_000
#: Values of a piece that is worked on at once, and the fewest neighbours in it.
_PIECE, _FEWEST = 1 << 16, 16
#: The first factor of a length n is about n to this power: measured from 5e5 to 2e7.
_SHARE = 0.43


def dct2(samples: FloatArray, mean: float = 0.0) -> FloatArray:
    """Return the orthonormal DCT-II of `samples` less a constant, shape (n,), as is quickest."""
    if samples.size >= LONG:
        return four_step_dct(samples, mean)
    from scipy.fft import dct

    transformed: FloatArray = dct(samples - mean, type=2, norm="ortho", overwrite_x=True)
    return transformed


def idct2(ordinates: FloatArray) -> FloatArray:
    """Return the samples, shape (n,), of which `ordinates`, which are overwritten, are the DCT-II."""
    if ordinates.size >= LONG:
        return four_step_idct(ordinates)
    from scipy.fft import idct

    samples: FloatArray = idct(ordinates, type=2, norm="ortho", overwrite_x=True)
    return samples


def split(n: int) -> int:
    """Return the divisor of `n` that serves best as one of its two factors: the nearest to n^0.43.

    A little less than the square root, as whole columns are stridden through, and rows are not.
    """
    small = [divisor for divisor in range(1, math.isqrt(n) + 1) if n % divisor == 0]
    wanted = n**_SHARE
    return min((*small, n // small[-1]), key=lambda divisor: max(divisor / wanted, wanted / divisor))


def four_step_dct(samples: FloatArray, mean: float) -> FloatArray:
    """Return the orthonormal DCT-II of `samples` less a constant, shape (n,); n should have small factors.

    It takes n log n operations, and 16 bytes a sample, half of which are the result. As exact as in one
    piece: errors are some 1e-15 of the largest ordinate.

    With v the even samples followed by the odd ones backwards, V its transform, and W = exp(-i pi k / 2n)
    V[k], ordinate k is the real part of W, and ordinate n - k its imaginary part with the sign changed.
    """
    from scipy.fft import fft

    n = samples.size
    rows = split(n)
    columns = n // rows
    result = np.empty(n)
    half = (n + 1) // 2
    np.subtract(samples[::2], mean, out=result[:half])
    np.subtract(samples[1::2], mean, out=result[half:][::-1])
    inner = _transformed_columns(result.reshape(rows, columns))
    # V[r + rows * c] stands in row r, column c; rows beyond the middle are conjugates of those before.
    place = result.reshape(columns, rows)
    shift = np.sqrt(2 / n) * np.exp(-0.5j * np.pi / columns * np.arange(columns))
    step = max(_FEWEST, _PIECE // columns)
    for start in range(0, len(inner), step):
        stop = min(start + step, len(inner))
        part = inner[start:stop] * _turns(np.arange(start, stop), n, columns)
        part = fft(part, axis=1, overwrite_x=True)
        part *= shift
        place[:, start:stop] = part.real.T
        # Of row 0, and of the one in the middle, these stand there already.
        first, last = max(start, 1), min(stop, (rows + 1) // 2)
        mirrored = place[::-1, rows - last + 1 : rows - first + 1]
        np.negative(part[first - start : last - start][::-1].imag.T, out=mirrored)
    result[0] *= np.sqrt(0.5)
    return result


def four_step_idct(ordinates: FloatArray) -> FloatArray:
    """Return the inverse of `four_step_dct` (the orthonormal DCT-III), shape (n,): its steps backwards.

    The ordinates are overwritten.
    """
    from scipy.fft import ifft, irfft

    n = ordinates.size
    rows = split(n)
    columns = n // rows
    place = ordinates.reshape(columns, rows)
    inner = np.empty((rows // 2 + 1, columns), dtype=np.complex128)
    shift = np.sqrt(n / 2) * np.exp(0.5j * np.pi / columns * np.arange(columns))
    step = max(_FEWEST, _PIECE // columns)
    for start in range(0, len(inner), step):
        stop = min(start + step, len(inner))
        part = inner[start:stop]
        part.real = place[:, start:stop].copy().T
        first = max(start, 1)
        part.imag[first - start :] = -place[::-1, rows - stop + 1 : rows - first + 1].copy().T[::-1]
        if start == 0:
            part.real[0, 0] *= np.sqrt(2)
            part.imag[0, 0] = 0.0
            part.imag[0, 1:] = -place[:0:-1, 0]
        part *= shift
        part[:] = ifft(part, axis=1, overwrite_x=True)
        part *= _turns(np.arange(start, stop), n, columns).conj()
    values = ordinates.reshape(rows, columns)
    step = max(_FEWEST, _PIECE // rows)
    for start in range(0, columns, step):
        values[:, start : start + step] = irfft(inner[:, start : start + step], rows, axis=0)
    del inner, part
    half = (n + 1) // 2
    result = np.empty(n)
    result[::2] = values.ravel()[:half]
    result[1::2] = values.ravel()[half:][::-1]
    return result


def _transformed_columns(values: FloatArray) -> ComplexArray:
    """Return the transform of each column, of real values: shape (rows // 2 + 1, columns)."""
    from scipy.fft import rfft

    rows, columns = values.shape
    transformed = np.empty((rows // 2 + 1, columns), dtype=np.complex128)
    step = max(_FEWEST, _PIECE // rows)
    for start in range(0, columns, step):
        part = slice(start, start + step)
        transformed[:, part] = rfft(values[:, part], axis=0)
    return transformed


def _turns(rows: IntArray, n: int, columns: int) -> ComplexArray:
    """Return exp(-2 pi i r (c + 1/4) / n) for rows r and columns c = 0 … columns - 1, shape (r, columns).

    Those of few columns times those of every so many.
    """
    few = math.isqrt(columns) + 1
    angle = (-2 * np.pi / n) * rows[:, np.newaxis]
    near = np.exp(1j * angle * (np.arange(few) + 0.25))
    far = np.exp(1j * angle * (few * np.arange(-(-columns // few))))
    products = far[:, :, np.newaxis] * near[:, np.newaxis, :]
    turns: ComplexArray = products.reshape(rows.size, -1)[:, :columns]
    return turns
