"""Pictures: no text overlaps or is cut off, and read-off points are correct."""

import io
import itertools
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from PIL import Image

from imucal.allan.dct import Spectrum
from imucal.fitting.noise_fit import Estimate, Line, Response
from imucal.noise.model import NoiseModel
from imucal.noise.term import Stroke
from imucal.noise.terms import TERMS
from imucal.recording import Axis, Sensor
from imucal.report.figure import axis_figure, render, sensor_figure
from imucal.report.figure_curves import draw_allan, drawn_terms, shown_points
from imucal.report.figure_style import AXES, DATA, MODEL
from imucal.report.numbers import sheet_units
from imucal.report.result import AxisReport
from tests.report.synthetic import axis_report, consumer_report, shortest_report, small_report
from tests.slow_cases import first_by_default


def _random_axis(seed: int) -> AxisReport:
    """Return an axis of cheap to navigation grade with any set of terms."""
    rng = np.random.default_rng(seed)
    sensor = Sensor.GYROSCOPE if seed % 2 else Sensor.ACCELEROMETER
    axis: Axis = ("x", "y", "z")[seed % 3]
    white = 10 ** rng.uniform(-6, -2)
    rate = float(rng.choice([50.0, 200.0, 1000.0]))
    n = int(rate * 10 ** rng.uniform(1.2, 4.5))
    flicker, walk = white * 10 ** rng.uniform(-2, 0), white * 10 ** rng.uniform(-4, -1)
    terms, bounds = [f"N={white}"], {}
    if rng.random() < 0.6:
        terms.append(f"B={flicker}")
    else:
        bounds["B"] = flicker
    if rng.random() < 0.5:
        terms += [
            f"GM(sigma={white * 10 ** rng.uniform(-1, 0)}, T={10 ** rng.uniform(-1, 3)})" for _ in range(2)
        ]
    if rng.random() < 0.6:
        terms.append(f"K={walk}")
    else:
        bounds["K"] = walk
    if rng.random() < 0.3:
        terms.append(f"R={walk / 30}")
    if rng.random() < 0.3:
        terms.insert(0, f"Q={white * 10 ** rng.uniform(-3, -1)}")
    nyquist = rate / 2
    return axis_report(
        sensor,
        axis,
        " + ".join(terms),
        bounds=bounds,
        rate_hz=rate,
        n=n,
        band_hz=(nyquist / 1e4, nyquist * float(rng.uniform(0.3, 1))),
        lines=tuple(Line(frequency_hz=nyquist * f, amplitude=white) for f in rng.uniform(0.05, 0.9, 4)),
        response=Response(cutoff_hz=nyquist * 0.6) if rng.random() < 0.4 else None,
    )


@pytest.mark.parametrize("seed", first_by_default(range(18), 7))
def test_no_text_of_an_axis_picture_overlaps_another(seed: int) -> None:
    """Sensors are random: cheap to navigation grade, seconds to hours, any set of terms."""
    axis = _random_axis(seed)
    figure = axis_figure(replace(consumer_report(), axes=(axis,)), axis)
    _check_texts(figure)


@pytest.mark.parametrize("index", range(6))
def test_no_text_of_a_typical_picture_overlaps_another(index: int) -> None:
    """The report is that of a consumer IMU, with Gauss-Markov terms, bounds, lines and a filter."""
    report = consumer_report()
    _check_texts(axis_figure(report, report.axes[index]))


@pytest.mark.parametrize("sensor", list(Sensor))
def test_no_text_of_an_overview_overlaps_another(sensor: Sensor) -> None:
    """The table below the plots is included."""
    _check_texts(sensor_figure(consumer_report(), sensor))


def test_an_overview_without_an_axis_is_an_error() -> None:
    with pytest.raises(ValueError, match="the report has no accelerometer axis"):
        sensor_figure(small_report(), Sensor.ACCELEROMETER)


def test_every_term_is_labelled_with_its_value_and_unit() -> None:
    """N, B and K are always labelled, and bounds are marked as bounds."""
    report = consumer_report()
    texts = [" ".join(_words(axis_figure(report, axis))) for axis in report.axes[:3]]
    assert "N 0.4125 ± 0.0016 deg/√h" in texts[0]
    assert "B 4.95 ± 0.19 deg/h" in texts[0]
    assert "K 13.6 ± 2.0 deg/h/√h" in texts[0]
    assert "49.97 Hz" in texts[0]
    assert "K < 5.1 deg/h/√h" in texts[1]
    assert "output filter\n-3 dB at 46 Hz" in texts[1]
    assert "B < 1.3 deg/h" in texts[2]
    assert "GM1 8.3 ± 0.6 deg/h\nT 90 ± 19 s" in texts[2]
    assert all("minimum" in text for text in texts)


def test_a_term_below_the_plot_is_labelled() -> None:
    """The label contains the number although the line is not visible."""
    axis = axis_report(Sensor.GYROSCOPE, "x", "N=1e-3 + B=1e-8 + K=1e-12")
    words = _words(axis_figure(replace(small_report(), axes=(axis,)), axis))
    assert "K 0.0000124 ± 0.0000018 deg/h/√h (below)" in words
    assert "B 0.00206 ± 0.00008 deg/h (below)" in words


@pytest.mark.parametrize(
    ("text", "tau", "height"),
    [
        ("N=1e-3", 1.0, 1e-3),
        ("K=1e-3", 3.0, 1e-3),
        ("Q=1e-3", 3**0.5, 1e-3),
        ("R=1e-3", 2**0.5, 1e-3),
        # The maximum of the continuous process is 0.617 sigma at 1.89 T.
        ("GM(sigma=1e-3, T=10)", 18.9, 6.174e-4),
    ],
)
def test_read_off_points_are_on_the_line_of_their_term(text: str, tau: float, height: float) -> None:
    """IEEE Std 952 reads each coefficient at this averaging time."""
    axis = axis_report(Sensor.GYROSCOPE, "x", text, rate_hz=1000.0)
    drawn = drawn_terms(axis.fit)[0]
    assert drawn.term.read_off()[0] == pytest.approx(tau)
    assert drawn.term.read_off()[1] == pytest.approx(height, rel=1e-3)
    avar = NoiseModel.parse(text).avar(np.array([round(tau * 1000)]), rate_hz=1000.0)
    # 1e-3: the sampled process differs from the continuous one by 1/(4 m²), and m is rounded.
    assert np.sqrt(avar[0]) == pytest.approx(height, rel=1e-3)


def test_uncertain_ends_of_the_curve_are_not_drawn() -> None:
    """Uncertain points have less than two degrees of freedom. If all points are uncertain, all are drawn."""
    curve = small_report().axes[0].fit.curve
    shown = shown_points(curve)
    assert (curve.edf[shown] >= 2).all()
    assert shown.size < curve.tau.size
    unknown = replace(curve, edf=np.full(curve.tau.size, np.nan))
    assert shown_points(unknown).size == curve.tau.size


def test_an_axis_without_a_spectrum_or_a_known_interval_can_be_drawn() -> None:
    """A curve of another tool has no samples."""
    report = small_report()
    axis = report.axes[0]
    empty = Spectrum(frequency=np.zeros(0), psd=np.zeros(0), count=np.zeros(0))
    curve = replace(axis.fit.curve, edf=np.full(axis.fit.curve.tau.size, np.nan))
    axis = replace(axis, spectrum=empty, fit=replace(axis.fit, curve=curve))
    bare = replace(report, axes=(axis,))
    _check_texts(axis_figure(bare, axis))
    _check_texts(sensor_figure(bare, Sensor.GYROSCOPE))


def test_a_dollar_sign_in_a_path_is_not_a_formula() -> None:
    """Paths with dollar signs exist in Windows and in shells."""
    report = small_report()
    report = replace(report, source=replace(report.source, path="C$/still$_^_\\night.csv"))
    assert "still$_^_\\night.csv" in _words(axis_figure(report, report.axes[0]))
    assert render(axis_figure(report, report.axes[0]), "png")


def test_drawing_changes_no_global_state() -> None:
    """Drawing uses no pyplot, chooses no backend and changes no setting."""
    before = dict(mpl.rcParams)
    report = small_report()
    render(axis_figure(report, report.axes[0]), "svg")
    assert dict(mpl.rcParams) == before
    assert "matplotlib.pyplot" not in str(axis_figure.__globals__)


def test_png_is_readable_at_800_pixels() -> None:
    """The PNG is twice as wide, so that screens can halve it; the smallest text then has at least 9 px."""
    report = small_report()
    figure = axis_figure(report, report.axes[0])
    image = Image.open(io.BytesIO(render(figure, "png", version="1")))
    assert image.width == 1600
    assert image.info["Software"] == "imucal 1"
    smallest = min(float(text.get_fontsize()) for text in _texts(figure))
    # 10 inches are 800 px wide, so there are 80 px per inch. Exponents at ticks have 0.7 of the text size.
    assert smallest * 80 / 72 >= 9


def test_an_unknown_format_is_refused() -> None:
    """The error lists the known formats."""
    report = small_report()
    with pytest.raises(ValueError, match="format 'bmp' is not one of png, svg, pdf"):
        render(axis_figure(report, report.axes[0]), "bmp")


@pytest.mark.parametrize("group", [{symbol: term.stroke for symbol, term in TERMS.items()}, AXES])
def test_colours_are_readable_and_distinguishable_without_colour(group: dict[str, Stroke]) -> None:
    """Text has a contrast of at least 4.5 on white and on the dark page (WCAG 2.2, AA).

    The dashes of the lines differ.
    """
    for stroke in (*group.values(), MODEL, DATA):
        assert _contrast(stroke.light, "#ffffff") >= 4.5
        assert _contrast(stroke.dark, "#12171d") >= 4.5
    dashes = [stroke.dashes for stroke in group.values()]
    assert len(set(dashes)) == len(dashes)


def test_axes_of_an_overview_are_distinguishable_by_the_colour_blind() -> None:
    """Under simulated protanopia and deuteranopia (Viénot 1999) all colours remain different."""
    for matrix in (
        [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]],
        [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]],
    ):
        seen = [np.array(matrix) @ np.array(to_rgb(s.light)) ** 2.2 for s in AXES.values()]
        for one, other in itertools.combinations(seen, 2):
            # 0.05 in linear light is about ten just noticeable differences at this lightness.
            assert np.linalg.norm(one - other) > 0.05


def _contrast(one: str, other: str) -> float:
    def luminance(colour: str) -> float:
        rgb = np.array(to_rgb(colour))
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    light, dark = sorted([luminance(one), luminance(other)], reverse=True)
    return (light + 0.05) / (dark + 0.05)


def _check_texts(figure: Figure) -> None:
    """Fail if two texts overlap, or if one is cut off by the edge of the picture."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    boxes = [(text.get_text(), _extent(text, renderer)) for text in _texts(figure)]
    frame = figure.bbox
    for text, box in boxes:
        assert frame.x0 <= box.x0 and box.x1 <= frame.x1, f"{text!r} is cut off"  # noqa: PT018
        assert frame.y0 <= box.y0 and box.y1 <= frame.y1, f"{text!r} is cut off"  # noqa: PT018
    for (text, box), (other, other_box) in itertools.combinations(boxes, 2):
        assert not _overlap(box, other_box), f"{text!r} overlaps {other!r}"


def _overlap(one: Bbox, other: Bbox) -> bool:
    # One pixel of tolerance, because extents are rounded up to whole pixels.
    apart = one.x0 + 1 >= other.x1 or other.x0 + 1 >= one.x1
    above = one.y0 + 1 >= other.y1 or other.y0 + 1 >= one.y1
    return not bool(apart or above)


def _extent(text: Text, renderer: object) -> Bbox:
    # The extent of an annotation would include its leader line.
    return Text.get_window_extent(text, renderer)  # type: ignore[arg-type]


def _words(figure: Figure) -> list[str]:
    return [text.get_text() for text in _texts(figure)]


def _texts(figure: Figure) -> list[Text]:
    """Return the visible texts; matplotlib also keeps labels of hidden ticks."""
    figure.draw_without_rendering()
    hidden = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not low <= tick.get_loc() <= high:
                    hidden |= {id(tick.label1), id(tick.label2)}
                if not tick.label2.get_visible():
                    hidden.add(id(tick.label2))
    found: list[Text] = figure.findobj(Text)
    return [t for t in found if t.get_visible() and t.get_text().strip() and id(t) not in hidden]


def test_the_overlap_check_finds_an_overlap() -> None:
    """A check that never fails would prove nothing."""
    figure = axis_figure(small_report(), small_report().axes[0])
    figure.text(0.5, 0.5, "over")
    figure.text(0.5, 0.5, "under")
    with pytest.raises(AssertionError, match="overlaps"):
        _check_texts(figure)


@pytest.mark.parametrize("n", [4, 10, 60])
def test_the_shortest_recordings_can_be_drawn(n: int) -> None:
    """The curve has two points, no term is detected, and the bounds are unknown."""
    report = shortest_report(n)
    _check_texts(axis_figure(report, report.axes[0]))
    _check_texts(sensor_figure(report, Sensor.ACCELEROMETER))


def test_the_legend_shows_only_marks_of_the_plot() -> None:
    """The line of a bounded B has no mark, that of N has a diamond."""
    report = small_report()
    fit = replace(report.axes[0].fit, estimates=(report.axes[0].fit["N"], Estimate.bounded("B", "B", 1e-4)))
    figure = Figure()
    FigureCanvasAgg(figure)
    entries = draw_allan(figure.add_subplot(), fit, sheet_units([fit]))
    marks = {
        entry.get_label().split()[0]: entry.get_marker() for entry in entries if hasattr(entry, "get_marker")
    }
    assert marks["N"] == "D"
    assert marks["B"] in {"None", "", None}


def test_a_picture_shows_the_alternatives_of_a_term() -> None:
    """The alternatives are in the table of a sensor and at the line of an axis."""
    report = consumer_report()
    axis = report.axes[0]
    estimate = replace(axis.fit["K"], alternatives=("GM",), horizon_s=564.0)
    fit = replace(axis.fit, estimates=tuple(estimate if e.key == "K" else e for e in axis.fit.estimates))
    changed = replace(report, axes=(replace(axis, fit=fit), *report.axes[1:]))
    note = "or GM, T > 564 s"
    assert note in {text.get_text() for text in sensor_figure(changed, axis.sensor).texts}
    (left, *_) = axis_figure(changed, changed.axes[0]).axes
    assert any(text.get_text().endswith(note) for text in left.texts)
