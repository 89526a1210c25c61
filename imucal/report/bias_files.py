"""The files of a decomposition: a table, arrays, a picture, and a document about all axes."""

import io
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from imucal.atomic import replacing
from imucal.errors import WriteError
from imucal.fitting.decomposition import Component, Decomposition
from imucal.report.figure import render
from imucal.report.figure_bias import averages, bias_figure

#: Of the document, whose name marks a folder as one of decompositions.
SCHEMA, DOCUMENT = "imucal/decomposition/1", "decomposition.json"
#: Most rows of a table where nobody says how many.
_ROWS = 10_000


def check_folder(out: Path) -> None:
    """Refuse a folder that holds something else, or can't be made, before hours of data are looked at.

    Raises
    ------
    WriteError
        Naming what stands there.
    """
    try:
        if not out.is_dir():
            if os.path.lexists(out):
                msg = f"{out}: is a file, expected a folder or nothing; move it away or choose another folder"
                raise WriteError(msg)
            home = next(folder for folder in out.absolute().parents if folder.exists())
            if not (home.is_dir() and os.access(home, os.W_OK | os.X_OK)):
                msg = f"{out}: can't be made: {home} takes no new folder; choose another place"
                raise WriteError(msg)
            return
        entries = sorted(path.name for path in out.iterdir())
    except OSError as error:
        msg = f"{out}: can't be looked at: {error.strerror or error}; choose another folder"
        raise WriteError(msg) from error
    if entries and DOCUMENT not in entries:
        shown = ", ".join(entries[:3]) + (", …" if len(entries) > 3 else "")
        msg = f"{out}: holds {shown} but no decomposition of imucal's; choose another folder"
        raise WriteError(msg)
    if not os.access(out, os.W_OK | os.X_OK):
        msg = f"{out}: is not yours to write to; choose another folder"
        raise WriteError(msg)


def write_decomposition(
    parts: Decomposition, out: Path, *, formats: Sequence[str] = ("png",), every_s: float | None = None,
    arrays: bool = False, source: str = "",
) -> tuple[Path, ...]:  # fmt: skip
    """Write the files of one axis into a folder, each whole or not at all.

    Parameters
    ----------
    formats
        Of the picture: ``png``, ``svg``, ``pdf``.
    every_s
        Seconds between the rows of the table; by default as many as give at most 10 000 rows.
    arrays
        Write everything at the rate of the samples too, as NumPy's npz.
    source
        The log's name, for the picture.

    Returns
    -------
    The paths: NAME.csv, NAME.png …, NAME.npz, with the name of the axis.

    Raises
    ------
    WriteError
        If a file can't be written.
    """
    name = parts.series.name
    made: dict[str, Callable[[], bytes]] = {f"{name}.csv": lambda: table(parts, every_s=every_s).encode()}
    for form in formats:
        made[f"{name}.{form}"] = lambda form=form: render(bias_figure(parts, source=source), form)  # type: ignore[misc]
    if arrays:
        made[f"{name}.npz"] = lambda: _arrays(parts)
    return tuple(_write(out / file, content()) for file, content in made.items())


def write_document(document: dict[str, object], out: Path) -> Path:
    """Write the document about all axes, which marks the folder; its path."""
    return _write(out / DOCUMENT, (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())


def _write(path: Path, content: bytes) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"{path.parent}: can't be made: {error.strerror or error}; choose another folder"
        raise WriteError(msg) from error
    with replacing(path) as scratch:
        scratch.write_bytes(content)
    return path


def table(parts: Decomposition, *, every_s: float | None = None) -> str:
    """Return the parts as CSV: a row every so many seconds, in SI, at the middle of what is averaged.

    Columns: time_s, count and mean of the samples around it (empty where all are missing), the bias
    and each part, each with its standard error (``_se``).
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
    """Return all at the rate of the samples, as npz."""
    held = {"time_s": parts.time_s, "samples": parts.samples, "residual": parts.residual}
    for part in (parts.bias, *parts.components):
        held |= {part.key: part.value, f"{part.key}_se": part.error}
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **held)
    return stream.getvalue()


def axis_document(parts: Decomposition, files: Sequence[Path]) -> dict[str, object]:
    """Return what is to say about one axis, as JSON values in SI."""
    series, seen = parts.series, np.isfinite(parts.samples)
    residual = parts.residual[seen]
    return {
        "name": series.name,
        "sensor": str(series.sensor),
        "axis": series.axis,
        "unit": series.unit,
        "model": parts.model.text(),
        "rate_hz": series.rate_hz,
        "samples": int(seen.sum()),
        "start_s": parts.start_s,
        "duration_s": parts.n * series.tau0,
        "residual": {"std": float(residual.std())},
        "components": [_component(part) for part in (parts.bias, *parts.components)],
        "files": [path.name for path in files],
    }


def _component(part: Component) -> dict[str, object]:
    """Return where a part moved, and how well that is known."""
    return {
        "key": part.key,
        "mean": float(part.value.mean()),
        "std": float(part.value.std()),
        "least": float(part.value.min()),
        "greatest": float(part.value.max()),
        "standard_error": float(np.median(part.error)),
    }
