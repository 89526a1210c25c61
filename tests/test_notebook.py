"""Tests of notebooks: values are displayed in a few lines and as the page's table."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import nbformat
import numpy as np
import polars as pl
import pytest
from lxml import html
from nbclient import NotebookClient

import imucal
from imucal.clock import Clock
from imucal.display import Displayed
from imucal.recording import Sensor
from imucal.report.view import views
from tests.fleet.simulated_store import write_store
from tests.report.synthetic import consumer_report

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_the_notebook_of_the_docs_runs(tmp_path: Path) -> None:
    """It runs completely in a folder with the sample logs and displays tables, pictures and texts."""
    shutil.copytree(ROOT / "sample_logs", tmp_path / "sample_logs")
    notebook = nbformat.read(ROOT / "docs" / "notebook.ipynb", as_version=4)  # type: ignore[no-untyped-call]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "IPYTHONDIR": str(tmp_path / "ipython")}
    # This variable of the user would prevent pictures in the notebook.
    environment.pop("MPLBACKEND", None)
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    client.create_kernel_manager()
    client.execute(env=environment)
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    kinds = [kind for output in outputs for kind in output.get("data", {})]
    assert kinds.count("image/png") == 3
    assert kinds.count("text/html") >= 9
    message = [output.text for output in outputs if output.output_type == "stream"]
    assert message == [
        "an array has no sampling rate; give one, such as imucal.fit(samples, rate_hz=200.0)\n"
    ]
    texts = [output["data"]["text/plain"] for output in outputs if "data" in output]
    assert max(len(text.splitlines()) for text in texts) <= 20
    assert (tmp_path / "imu.yaml").is_file()
    if kept := os.environ.get("IMUCAL_KEEP_NOTEBOOK"):
        nbformat.write(notebook, kept)  # type: ignore[no-untyped-call]


def _recording() -> imucal.Recording:
    rng = np.random.default_rng(8)
    series = [
        imucal.AxisSeries.from_samples(rng.standard_normal(4000), rate_hz=100.0, sensor=sensor, axis=axis)
        for sensor in ("gyroscope", "accelerometer")
        for axis in ("x", "y", "z")
    ]
    return imucal.Recording(source=consumer_report().source, series=tuple(series))


def _values() -> dict[str, Displayed]:
    report, recording = consumer_report(), _recording()
    return {
        "recording": recording,
        "series": recording["gyro_x"],
        "curve": report.axes[0].fit.curve,
        "fit": report.axes[2].fit,
        "report": report,
    }


@pytest.mark.parametrize("name", _values())
def test_values_are_displayed_in_twelve_lines(name: str) -> None:
    """The forms are text, one or two tables, and a data frame with one row per value."""
    value = _values()[name]
    assert 1 <= len(repr(value).splitlines()) <= 12
    assert max(map(len, repr(value).splitlines())) < 200
    tables = html.fromstring(value._repr_html_()).xpath(".//table")
    assert len(tables) == (2 if name == "report" else 1)
    assert all(table.xpath("caption") for table in tables)
    assert isinstance(value.to_frame(), pl.DataFrame)
    assert value.to_frame().height > 1


def test_a_fleet_is_displayed(tmp_path: Path) -> None:
    """The text has a line per sensor model, the table equals the page, the frame has all terms and axes."""
    write_store(tmp_path / "fleet", units=4, weak="", failures=False, names=("gyro_x",))
    fleet = imucal.load_fleet(tmp_path / "fleet")
    assert 2 <= len(repr(fleet).splitlines()) <= 12
    assert html.fromstring(fleet._repr_html_()).cssselect("table.limits")
    assert fleet.to_frame().height == sum(len(model.terms) for model in fleet.models)


def test_a_data_frame_equals_the_table() -> None:
    """There is a row per term and axis, and bounded terms have no value."""
    report = consumer_report()
    frame = report.to_frame()
    assert frame.height == sum(1 for seen in views(report) for row in seen.rows for cell in row.cells if cell)
    bound = frame.filter((pl.col("axis") == "gyro_y") & (pl.col("term") == "K")).row(0, named=True)
    assert (bound["value"], bound["low"], bound["high"]) == (None, 0.0, 4.1e-7)
    assert bound["sheet_unit"] == "deg/h/sqrt(h)"


def test_axes_and_terms_are_found_by_their_names() -> None:
    """Parts of a recording are selected by durations."""
    report = consumer_report()
    assert report["gyro_x"]["N"] is report.axes[0].fit["N"]
    recording = _recording()
    assert recording["accel_z"] is recording.axis("accel", "z") is recording.axis("accelerometer", "z")
    assert recording.skip("10s").take("0.5min")["gyro_x"].duration_s == pytest.approx(30.0)
    assert recording.skip(35)["gyro_y"].n == 500


def test_a_part_only_reports_its_own_gaps() -> None:
    clock = Clock.even(1000, 100.0).keeping(np.arange(1000) != 50)
    series = imucal.AxisSeries(sensor=Sensor.GYROSCOPE, axis="x", samples=np.ones(999), clock=clock)
    recording = imucal.Recording(source=consumer_report().source, series=(series,)).between(0.0, np.inf)
    assert [finding.code for finding in recording.findings] == ["gaps"]
    assert recording.skip("1s").findings == ()


_SAMPLES = np.random.default_rng(3).standard_normal(2000)


#: Users call the functions without type checks.
_api: Any = imucal


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: _api.fit(_SAMPLES), "give one, such as imucal.fit(samples, rate_hz=200.0)"),
        (lambda: _api.fit("log.mcap"), "log.mcap: can't be opened"),
        (lambda: _api.fit(_SAMPLES.reshape(-1, 2), rate_hz=1.0), "give one axis, such as samples[:, 0]"),
        (lambda: _api.fit(object()), "found object, expected a recording"),
        (lambda: _api.fit(_SAMPLES, rate_hz=-1.0), "rate_hz must be positive"),
        (
            lambda: _api.fit(_SAMPLES, rate_hz=1.0, method="mlee"),
            "method 'mlee' is not one of mle, gmwm, slope",
        ),
        (lambda: _api.fit(_SAMPLES, rate_hz=1.0, sensor="baro"), "'baro' is not a valid Sensor"),
        (lambda: _api.fit(_recording(), rate_hz=1.0), "omit rate_hz"),
        (lambda: _api.export(consumer_report(), "kalibrr", "k.yaml"), "did you mean kalibr?"),
        (lambda: _api.export(3, "kalibr", "k.yaml"), "found int, expected a report"),
        (
            lambda: _api.check(consumer_report()),
            "type check(report, 'limits.toml'), or give config='imu.yaml'",
        ),
        (lambda: _api.check(consumer_report(), "N = 3"), "N"),
        (lambda: consumer_report()["gyro"], "no axis 'gyro'; the report has gyro_x, gyro_y, gyro_z, accel_x"),
        (lambda: consumer_report()["gyro_x"]["Z"], "no term 'Z'; the fit has N, B, K"),
        (lambda: _recording()["x"], "no axis 'x'; found gyro_x"),
        (lambda: _recording().skip("2 fortnights"), "write seconds, or for example 90s, 5min, 2.5h"),
        (lambda: imucal.plot(3), "int can't be plotted; give a recording"),
        (lambda: imucal.info("nothing.mcap"), "nothing.mcap"),
    ],
)
def test_errors_suggest_a_command(call: Callable[[], object], message: str) -> None:
    """Each is an `ImucalError` of one sentence, with an exit code for scripts."""
    with pytest.raises(imucal.ImucalError) as caught:
        call()
    assert message in str(caught.value)
    assert caught.value.exit_code in {2, 3, 4}


def test_arrays_and_recordings_are_fitted() -> None:
    """An array is an axis, and a recording is characterised."""
    fit = imucal.fit(list(_SAMPLES), rate_hz=100.0, sensor="accelerometer")
    assert fit.sensor is Sensor.ACCELEROMETER
    assert fit["N"].value == pytest.approx(0.1, rel=0.1)
    recording = _recording()
    one = replace(recording, series=recording.series[:1])
    report = imucal.fit(one, model="N", segments=1)
    assert str(report["gyro_x"].fit.model) == "N"


def test_export_and_check_accept_paths(tmp_path: Path) -> None:
    """A report is given by its folder, limits by a file or text, a config by its file."""
    imucal.write_report(consumer_report(), tmp_path / "out", formats=(), html=False)
    (config,) = imucal.export(str(tmp_path / "out"), "kalibr", str(tmp_path / "k.yaml"))
    assert imucal.check(tmp_path / "out", config=config).passed
    limits = "[gyroscope]\nN = { max = 1e-5 }\n"
    (tmp_path / "limits.toml").write_text(limits, encoding="utf-8")
    assert not imucal.check(consumer_report(), limits).passed
    assert not imucal.check(consumer_report(), tmp_path / "limits.toml").passed


@pytest.mark.parametrize("name", _values())
def test_all_values_can_be_plotted(name: str) -> None:
    """The axes are returned; given axes are used without a new figure."""
    mpl.use("agg")
    import matplotlib.pyplot as plt

    value, several = _values()[name], name in {"recording", "report"}
    plotted = imucal.plot(value)
    places = plotted if isinstance(plotted, tuple) else (plotted,)
    assert len(places) == 1 + several
    assert all(place.get_xlabel().startswith(("averaging time", "time")) for place in places)
    before = plt.get_fignums()
    _, given = plt.subplots(1, len(places), squeeze=False)
    again = imucal.plot(value, ax=given[0] if several else given[0][0])
    assert (again if isinstance(again, tuple) else (again,)) == tuple(given[0])
    assert len(plt.get_fignums()) == len(before) + 1
    plt.close("all")


def test_a_plot_of_two_sensors_needs_two_axes() -> None:
    """Their units differ."""
    from matplotlib.figure import Figure

    with pytest.raises(imucal.ImucalError, match="found 1 axes"):
        imucal.plot(consumer_report(), ax=Figure().subplots())


def test_the_display_of_values_is_imported_lazily() -> None:
    code = "import imucal, sys; imucal.Recording; print('imucal.report.notebook' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout == "False\n"
