"""The columns of a fleet's tables, with their types."""

import polars as pl

#: How a log ended. The first three are of the log itself; the others may go otherwise another time.
STATUSES = ("ok", "unreadable", "no-data", "memory", "timeout", "crash")

_TEXT, _REAL, _COUNT = pl.String(), pl.Float64(), pl.Int64()
#: What a log's labels are, from the manifest or its path.
LABELS = {"model": _TEXT, "unit": _TEXT, "temperature_c": _REAL, "started": _TEXT}
#: One row a log asked for; free columns of text may follow. `options` is how to read it where that differs
#: from the others (JSON), `copy_of` the path of the log that has the same content.
MANIFEST = {"path": _TEXT, **LABELS, "options": _TEXT, "copy_of": _TEXT}
#: One row a log done. `edge` is a checksum of size, beginning and end, `finished` a Unix time in s.
LOGS = {
    **dict.fromkeys(("key", "content", "edge", "path"), _TEXT),
    **LABELS,
    **dict.fromkeys(("status", "reason", "verdict"), _TEXT),
    "findings": pl.List(_TEXT),
    "samples": _COUNT,
    **dict.fromkeys(("seconds", "rate_hz"), _REAL),
    **dict.fromkeys(("bytes", "mtime_ns"), _COUNT),
    **dict.fromkeys(("cpu_s", "wall_s", "finished"), _REAL),
    **dict.fromkeys(("report", "version"), _TEXT),
}
#: One row a log, axis and term; the fields of `imucal.LogValue`, in SI.
RESULTS = {
    **dict.fromkeys(("key", "sensor", "axis", "term", "unit_si"), _TEXT),
    **dict.fromkeys(("value", "low", "high", "variance", "variance_sd", "variance_growth"), _REAL),
    **dict.fromkeys(("level", "correlation_time"), _REAL),
}
#: One row a log and axis: its binned spectrum.
BINS = {"key": _TEXT, "sensor": _TEXT, "axis": _TEXT, "bins": pl.Binary()}
