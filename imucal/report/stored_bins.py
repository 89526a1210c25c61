"""The bins of a fit as JSON values, and back without losing a digit."""

import numpy as np

from imucal.fitting.bins import BINS_VERSION, Bins
from imucal.report.reading import Node


def bins_document(bins: Bins) -> dict[str, object]:
    """Return the JSON values of bins; of the symmetric `gram` the rows of its lower triangle."""
    rows = range(len(bins.names))
    return {
        "version": bins.version,
        "scale": bins.scale,
        "tau0_s": bins.tau0,
        "widening": bins.widening,
        "n": bins.n.tolist(),
        "start": bins.start.tolist(),
        "first": bins.first.tolist(),
        "size": bins.size.tolist(),
        "power": bins.power.tolist(),
        "regressors": list(bins.names),
        "cross": bins.cross.tolist(),
        "gram": [bins.gram[i, j].tolist() for i in rows for j in rows[: i + 1]],
    }


def read_bins(node: Node) -> Bins:
    """Return the bins of a document.

    Raises
    ------
    ReadError
        If they are of another version, or their lists do not belong together.
    """
    version = node["version"].count()
    if version != BINS_VERSION:
        node["version"].fail(f"found {version}", f"{BINS_VERSION}, as this version of imucal writes")
    names = node["regressors"].texts()
    n = node["n"].counts()
    start, first = node["start"].counts(like=n.size), node["first"].counts()
    if not n.size or start[0] != 0 or np.any(np.diff([*start, first.size]) < 1):
        node["start"].fail("found starts that are not those of blocks", "rising ones from 0")
    blocks = zip(n.tolist(), np.split(first, start[1:]), strict=True)
    if not all(own[0] >= 1 and own[-1] < size and np.all(np.diff(own) > 0) for size, own in blocks):
        node["first"].fail("found ordinates that do not rise within a block", "rising ones below its n")
    cross = [row.array(like=first.size) for row in node["cross"]]
    lower = [row.array(like=first.size) for row in node["gram"]]
    r = len(names)
    if len(cross) != r or len(lower) != r * (r + 1) // 2 or not r:
        node["cross"].fail(f"found {len(cross)} and {len(lower)} lists", f"those of {r} regressors")
    gram = np.zeros((r, r, first.size))
    for i, j, row in zip(*np.tril_indices(r), lower, strict=True):
        gram[i, j] = gram[j, i] = row
    return Bins(
        n=n,
        start=start,
        first=first,
        size=node["size"].array(like=first.size),
        power=node["power"].array(like=first.size),
        names=names,
        cross=np.array(cross),
        gram=gram,
        scale=node["scale"].positive(),
        tau0=node["tau0_s"].positive(),
        widening=node["widening"].positive(),
        version=version,
    )
