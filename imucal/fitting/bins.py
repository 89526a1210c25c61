"""Bins: the data from which the likelihood of one axis can be evaluated again without the samples."""

from dataclasses import dataclass

from imucal.arrays import FloatArray, IntArray, ReadOnlyArrays


@dataclass(frozen=True, kw_only=True, eq=False)
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
