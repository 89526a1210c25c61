"""The folder of a decomposition: a table, arrays and a picture of each axis, and a document about all."""

import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imucal.fitting.decomposition import Decomposition
from imucal.fitting.wiener import Component
from imucal.report import figure as drawing
from imucal.report.figure_bias import averages, bias_figure
from imucal.report.out_folder import FilesOfFolder, OutFolder
from imucal.report.typed_json import JsonObject, picked

SCHEMA = "imucal/decomposition/1"
#: File that marks the folder of a decomposition.
DOCUMENT = "decomposition.json"
#: Names of the files that a decomposition writes.
_OWN = re.compile(r"(gyro|accel)_[xyz]\.(csv|npz|png|svg|pdf)|decomposition\.json")
#: Largest number of rows of a table by default.
_ROWS = 10_000


def out_folder(out: Path) -> OutFolder:
    """Return the folder that a decomposition is written to."""
    return OutFolder(path=out, what="imucal decomposition", document=DOCUMENT, schema=SCHEMA, own=_OWN)


def write_decomposition(
    parts: Decomposition, files: FilesOfFolder, *, formats: Sequence[str] = ("png",),
    every_s: float | None = None, arrays: bool = False, source: str = "",
) -> tuple[Path, ...]:  # fmt: skip
    """Write the files of one axis; return the paths at which they will appear.

    With `arrays`, NAME.npz has the rate of the samples. The table has at most 10 000 rows by default.
    `source` is the log's name. Raises WriteError.
    """
    name = parts.series.name
    paths = [files.add(f"{name}.csv", table(parts, every_s=every_s).encode())]
    for form in formats:
        picture = drawing.render(bias_figure(parts, source=source), form)
        paths.append(files.add(f"{name}.{form}", picture))
    if arrays:
        paths.append(files.add(f"{name}.npz", _arrays(parts)))
    return tuple(paths)


def table(parts: Decomposition, *, every_s: float | None = None) -> str:
    """Return the parts as CSV in SI: a row every `every_s` seconds, at the middle of the averaged samples.

    Columns: time_s, number and mean of the averaged samples (empty if all are missing), then the bias and
    each part, each followed by its standard error (``_se``).
    """
    width = max(1, -(-parts.n // _ROWS))
    if every_s is not None:
        width = max(1, round(every_s / parts.series.tau0))
    time, mean, count = averages(parts, width)
    place = np.minimum(np.arange(0, parts.n, width) + width // 2, parts.n - 1)
    columns = [parts.bias, *parts.components]
    heading = ["time_s", "count", "samples", *(f"{c.key}{end}" for c in columns for end in ("", "_se"))]
    values = [array[place] for c in columns for array in (c.value, c.error)]
    lines = [",".join(heading)]
    for t, number, samples, *rest in zip(time, count, mean, *values, strict=True):
        first = f"{t:.12g},{number:.0f},{'' if np.isnan(samples) else f'{samples:.10g}'}"
        lines.append(",".join([first, *(f"{value:.10g}" for value in rest)]))
    return "\n".join(lines) + "\n"


def _arrays(parts: Decomposition) -> bytes:
    held = {"time_s": parts.time_s, "samples": parts.samples, "residual": parts.residual}
    for part in (parts.bias, *parts.components):
        held |= {part.key: part.value, f"{part.key}_se": part.error}
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **held)
    return stream.getvalue()


def axis_document(parts: Decomposition, files: Sequence[Path]) -> JsonObject:
    """Return the entry of one axis as JSON values in SI."""
    series, seen = parts.series, np.isfinite(parts.samples)
    residual = parts.residual[seen]
    return {
        **picked(series, "name sensor axis unit"),
        "model": parts.model.text(),
        "rate_hz": series.rate_hz,
        "samples": int(seen.sum()),
        "start_s": parts.start_s,
        "duration_s": parts.n * series.tau0,
        "residual": {"std": float(residual.std())},
        "components": [_component(part) for part in (parts.bias, *parts.components)],
        "files": [path.name for path in files],
    }


def _component(part: Component) -> JsonObject:
    moved = zip(("mean", "std", "least", "greatest"), ("mean", "std", "min", "max"), strict=True)
    found = {name: float(getattr(part.value, method)()) for name, method in moved}
    return {"key": part.key, **found, "standard_error": float(np.median(part.error))}
