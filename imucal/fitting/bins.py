"""Bins: what the likelihood of one axis needs, so that it can be evaluated again without the samples."""

from dataclasses import dataclass

from imucal.arrays import FloatArray, IntArray, read_only

#: Number of the layout of `Bins`; one that an old reader would misunderstand raises it.
BINS_VERSION = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bins:
    """The binned DCT ordinates of an axis: sums of squares, and of products with the regressors.

    The samples stand in k unbroken blocks, the bins of one after those of the other, b in all. With r
    regressors that is some 8 (3 + r + r²) b bytes, b about 600 for 10⁵ samples.

    Attributes
    ----------
    n
        Number of samples of each block, shape (k,).
    start
        Where in the other arrays each block begins, shape (k,).
    first
        First ordinate of each bin, shape (b,); a bin ends where the next of its block begins, the last
        one at the ordinate n - 1.
    size
        Degrees of freedom of each bin, shape (b,).
    power
        Sum of the squared ordinates, shape (b,), in units of `scale`².
    names
        Regressors: ``R`` first, then what the fit of this axis took out.
    cross
        Sums of ordinate times regressor's ordinate, shape (r, b), in units of `scale`.
    gram
        Sums of products of regressors' ordinates, shape (r, r, b).
    scale
        U per scaled unit, a power of two: exact.
    tau0
        Sampling period, in s.
    widening
        By what factor heavy tails make the interval of N wider, at least 1.
    version
        Of this layout.
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
            msg = f"bins: {', '.join(wrong) or 'n'} do not fit {bins} bins of {regressors} names"
            raise ValueError(msg)
        for name in ("n", "first", *shapes):
            object.__setattr__(self, name, read_only(getattr(self, name)))
