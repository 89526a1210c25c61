"""Bins in report.json: written on request, and read back exactly."""

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import imucal
from imucal.errors import ReadError
from imucal.report.json_file import from_document, schema, to_document
from imucal.report.json_node import dumps
from imucal.report.result import Report
from tests.cli.run import run
from tests.fleet.records import fit_of, simulated
from tests.report.synthetic import small_report


def _report(*, bins: bool) -> Report:
    """Return a report of one axis with the bins of a record with a gap."""
    report = small_report()
    samples = np.concatenate([simulated("N=1 + K=1e-1", 400, 3), np.full(100, np.nan)])
    fit = fit_of(np.concatenate([samples, simulated("N=1", 300, 4)]))
    axis = report.axes[0]
    axis = replace(axis, fit=replace(axis.fit, bins=fit.bins))
    settings = {**report.settings, "bins": True} if bins else report.settings
    return replace(report, axes=(axis,), settings=settings)


def test_bins_are_read_back_with_all_digits() -> None:
    """The document is valid by the schema."""
    report = _report(bins=True)
    text = dumps(to_document(report))
    jsonschema.Draft202012Validator(schema()).validate(json.loads(text))
    again = from_document(json.loads(text))
    assert dumps(to_document(again)) == text
    ours, theirs = report.axes[0].fit.bins, again.axes[0].fit.bins
    assert ours is not None
    assert theirs is not None
    assert len(ours.n) == 2
    for name in (
        "n",
        "start",
        "first",
        "size",
        "power",
        "cross",
        "gram",
        "names",
        "scale",
        "tau0",
        "widening",
    ):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name


def test_bins_are_written_only_on_request() -> None:
    """Bins would be the largest part of the file."""
    document: Any = to_document(_report(bins=False))
    assert "bins" not in document["axes"][0]["fit"]


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("version", 2, r"bins.version: found 2, expected 1"),
        ("power", [1.0], r"bins.power: found a list of 1"),
        ("start", [0, 0], r"bins.start: found starts"),
        ("n", [3, 4], r"bins.first: found ordinates"),
        ("cross", [], r"bins.cross: found 0 and 1 lists"),
        ("tau0_s", 0, r"bins.tau0_s: found 0"),
    ],
)
def test_inconsistent_bins_are_refused(key: str, value: object, text: str) -> None:
    """The error contains the place, the content and the expected form."""
    document: Any = copy.deepcopy(to_document(_report(bins=True)))
    document["axes"][0]["fit"]["bins"][key] = value
    with pytest.raises(ReadError, match=text):
        from_document(document)


@pytest.mark.usefixtures("pictures_are_blank")
def test_reports_with_bins_can_be_pooled(tmp_path: Path) -> None:
    """The test follows the advice in the error: run `imucal fit --bins` twice and pool the reports."""
    fits = []
    for name, flags in (("one", ["--bins"]), ("two", ["--bins"]), ("three", [])):
        log, out = tmp_path / f"{name}.csv", tmp_path / name
        rng = np.random.default_rng(len(name))
        rows = np.column_stack([np.arange(1500) / 100.0, rng.standard_normal(1500) * 1e-2])
        np.savetxt(log, rows, delimiter=",", header="t,gz", comments="")
        arguments = ["fit", str(log), "-o", str(out), "--no-html", "--gyro-unit", "rad/s", "-q", "--force"]
        done = run(*arguments, *flags, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        fits.append(imucal.load_report(out).axes[0].fit)
    pooled = imucal.pool(fits[:2], model="N")
    assert pooled["N"].low < 1e-3 < pooled["N"].high
    with pytest.raises(imucal.DataError, match="imucal fit --bins"):
        imucal.pool(fits)
