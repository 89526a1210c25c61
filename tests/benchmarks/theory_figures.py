"""The pictures and tables of docs/theory.md, from simulated noise.

    python tests/benchmarks/theory_figures.py [folder]

It writes the pictures to docs/images (or the folder) and prints the tables in Markdown, in some minutes.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import chdtri, ndtri

from imucal import AxisSeries, NoiseModel, allan_curve, decompose, fit
from imucal.allan.intervals import GenericModel, model_edf
from imucal.allan.variance import variances
from imucal.arrays import FloatArray
from imucal.noise.integrals import avar_from_acvf, avar_from_psd
from imucal.report.figure import render
from imucal.report.figure_bias import bias_figure
from imucal.report.figure_style import AXES, DATA, FADED, INK, LABEL_SIZE, MODEL, new_figure, style_axes

__all__ = ["FIGURES", "RIPPLE", "flicker", "moving_average", "rippled"]

#: Size of the ripple that the curve does not show, relative to the flicker noise.
RIPPLE = 0.8
_COLOURS = [AXES[axis].light for axis in "xyz"]
_SIZE = 9.0
_Limits: TypeAlias = tuple[float, float]


def moving_average(theta: float, m: FloatArray) -> FloatArray:
    """Return the Allan variance of y[t] = e[t] + theta e[t-1], e of variance 1: the chapter's example."""
    plain = 1 + theta**2
    return np.asarray(plain / m**2 * (m + (2 * m - 3) * theta / plain))


def flicker(f: FloatArray) -> FloatArray:
    """Return the density 1/f."""
    return np.asarray(1 / f)


def rippled(f: FloatArray) -> FloatArray:
    """Return 1/f with Phi(f) = 2 Phi(2f) added: a ripple with one period per octave."""
    return np.asarray((1 + RIPPLE * np.cos(2 * np.pi * np.log2(f))) / f)


def _panels(count: int, height: float = 3.4) -> tuple[Figure, list[Axes]]:
    figure = new_figure(10.0, height, 100)
    width, left, gap = 0.915 / count - 0.065, 0.075, 0.085
    axes = [figure.add_axes((left + i * (width + gap), 0.15, width, 0.74)) for i in range(count)]
    return figure, axes


def _log_axes(axes: Axes, title: str, names: tuple[str, str], xs: _Limits, ys: _Limits) -> None:
    style_axes(axes, x=names[0], y=names[1], x_limits=xs, y_limits=ys)
    axes.set_title(title, fontsize=10, loc="left", color=INK, fontweight="bold")


def _legend(axes: Axes, place: Literal["upper right", "lower left", "lower right", "upper center"]) -> None:
    axes.legend(fontsize=_SIZE, frameon=False, labelcolor=INK, loc=place)


def moving_average_figure(records: int = 200) -> Figure:
    """Draw MA(1): the closed form, the integral of its psd, the sum of its acvf, and simulated samples."""
    figure, (left, right) = _panels(2)
    m, few = np.unique(np.geomspace(1, 1000, 60).round()), 2 ** np.arange(10)
    f = np.geomspace(1e-3, 0.5, 300)
    rng = np.random.default_rng(81)
    for theta, colour in zip((-0.9, 0.0, 0.9), _COLOURS, strict=True):
        left.plot(m, np.sqrt(moving_average(theta, m)), color=colour, linewidth=1.5, label=f"θ = {theta:g}")

        def psd(at: FloatArray, theta: float = theta) -> FloatArray:
            return np.asarray(1 + theta**2 + 2 * theta * np.cos(2 * np.pi * at))

        by_psd, by_acvf = avar_from_psd(psd, few, 1.0), avar_from_acvf([1 + theta**2, theta], few)
        left.plot(few, np.sqrt(by_psd), "o", color=colour, markersize=7, markerfacecolor="none")
        left.plot(few, np.sqrt(by_acvf), "+", color=colour, markersize=12)
        noise = rng.standard_normal((records, 4001))
        drawn = noise[:, 1:] + theta * noise[:, :-1]
        mean = np.mean([variances(one, few) for one in drawn], axis=0)
        left.plot(few, np.sqrt(mean), ".", color=INK, markersize=4, zorder=9)
        right.plot(f, psd(f), color=colour, linewidth=1.5)
    left.plot([], [], "o", color=FADED, markerfacecolor="none", label="avar_from_psd")
    left.plot([], [], "+", color=FADED, label="avar_from_acvf")
    left.plot([], [], ".", color=INK, label=f"mean of {records} simulated records")
    _log_axes(left, "MA(1), σ = 1", ("averaging factor m", "Allan deviation"), (0.8, 800), (1e-3, 3))
    _log_axes(right, "its density", ("frequency (cycles a sample)", "psd, two-sided"), (1e-3, 0.5), (5e-3, 6))
    _legend(left, "lower left")
    return figure


def additivity_figure(n: int = 1_000_000) -> Figure:
    """Draw the curve of a sum and the sum of the curves."""
    figure, (axes, other) = _panels(2)
    rate, text = 100.0, "Q=3e-5 + N=1e-3 + B=2e-4 + K=3e-5"
    model = NoiseModel.parse(text)
    series = AxisSeries.from_samples(
        model.simulate(n, rate_hz=rate, rng=np.random.default_rng(82)), rate_hz=rate
    )
    curve = allan_curve(series)
    m = np.geomspace(1, n / 2, 200).round()
    low, high = curve.confidence_interval(0.95)
    axes.fill_between(curve.tau, low, high, color=DATA.light, alpha=0.2, linewidth=0)
    axes.plot(curve.tau, curve.adev, ".", color=DATA.light, markersize=6, label="simulated, 95 %")
    axes.plot(m / rate, np.sqrt(model.avar(m, rate_hz=rate)), color=MODEL.light, linewidth=1.8, label="sum")
    f = np.geomspace(rate / n, rate / 2, 300)
    for term in model.terms:
        style: dict[str, Any] = {"color": term.stroke.light, "linewidth": 1.2, "dashes": term.stroke.dashes}
        axes.plot(m / rate, np.sqrt(term.avar(m, 1 / rate)), label=term.symbol, **style)
        other.plot(f, term.psd(f, 1 / rate), **style)
    other.plot(f, model.psd(f, rate_hz=rate), color=MODEL.light, linewidth=1.8)
    limits = (float(curve.adev.min()) / 6, float(curve.adev.max()) * 2)
    _log_axes(axes, text, ("averaging time τ (s)", "Allan deviation (rad/s)"), (0.008, 8e3), limits)
    _log_axes(
        other, "its densities", ("frequency (Hz)", "psd (rad²/s²/Hz)"), (rate / n, rate / 2), (1e-9, 1e-1)
    )
    _legend(axes, "upper center")
    return figure


def ambiguity_figure() -> Figure:
    """Draw two densities and their common curve."""
    figure, (left, right) = _panels(2)
    f, tau = np.geomspace(1e-3, 1, 800), np.geomspace(1, 1000, 40)
    left.plot(f, rippled(f), color=_COLOURS[0], linewidth=1.5, label="(1 + 0.8 cos(2π log₂ f))/f")
    left.plot(f, flicker(f), color=_COLOURS[1], linewidth=1.5, label="1/f")
    m = tau.round()
    one, other = (avar_from_psd(psd, m, 1.0, sampled=False) for psd in (flicker, rippled))
    right.plot(m, np.sqrt(other), color=_COLOURS[0], linewidth=7, alpha=0.4)
    right.plot(m, np.sqrt(one), color=_COLOURS[1], linewidth=1.3)
    worst = float(np.max(np.abs(other / one - 1)))
    right.text(1.4, 1.15, f"relative difference at most {worst:.0e}", fontsize=_SIZE, color=INK)
    _log_axes(left, "two densities", ("frequency (Hz)", "psd, two-sided"), (1e-3, 1), (0.1, 3e3))
    _log_axes(right, "one Allan deviation", ("averaging time τ (s)", "Allan deviation"), (1, 1000), (0.5, 5))
    _legend(left, "upper right")
    return figure


def _moments(records: int, n: int, m: FloatArray) -> tuple[FloatArray, dict[str, FloatArray], FloatArray]:
    """Return Allan variances of WN + RW, shape (r, k), the coverage of three intervals, and edf of each m."""
    model = NoiseModel.parse("N=1 + K=0.02")
    rng, truth = np.random.default_rng(83), model.avar(m, rate_hz=1.0)
    generic = GenericModel(variances=(0.0, 1.0, 0.0, 0.02**2))
    exact = np.array([model_edf(generic, int(k), n - 2 * k + 1) for k in m])
    q, avar = float(ndtri(0.975)), np.empty((records, m.size))
    held: dict[str, list[np.ndarray]] = {name: [] for name in ("imucal", "exact", "counted")}
    for i in range(records):
        series = AxisSeries.from_samples(model.simulate(n, rate_hz=1.0, rng=rng), rate_hz=1.0)
        curve = allan_curve(series, taus=m.tolist())
        avar[i] = curve.avar
        low, high = curve.confidence_interval(0.95)
        held["imucal"].append((low**2 <= truth) & (truth <= high**2))
        held["exact"].append(np.abs(curve.avar - truth) <= q * np.sqrt(2 / exact) * curve.avar)
        held["counted"].append(np.abs(curve.avar - truth) <= q / np.sqrt(2 * (n / m - 1)) * curve.avar)
    return avar, {name: np.mean(values, axis=0) for name, values in held.items()}, exact


def coverage_figure(records: int = 1000, n: int = 4096) -> Figure:
    """Draw the distribution for few and many averages, the long-run variance, and the intervals' coverage."""
    figure, (shape, spread, cover) = _panels(3)
    m: FloatArray = np.exp2(np.arange(int(np.log2(n / 4)) + 1))
    avar, held, exact = _moments(records, n, m)
    truth = NoiseModel.parse("N=1 + K=0.02").avar(m, rate_hz=1.0)
    score = np.linspace(-3, 4.5, 200)
    for place, colour in zip((2, int(m.size) - 1), _COLOURS, strict=False):
        values = (avar[:, place] / truth[place] - 1) * np.sqrt(exact[place] / 2)
        shape.hist(values, bins=np.arange(-3, 4.6, 0.3).tolist(), density=True, color=colour, alpha=0.35,
                   label=f"m = {m[place]:.0f}, EDF {float(f'{exact[place]:.2g}'):g}")  # fmt: skip
    shape.plot(score, np.exp(-(score**2) / 2) / np.sqrt(2 * np.pi), color=INK, linewidth=1.2, label="normal")
    shape.set(xlim=(-3, 4.5), ylim=(0, 1.05), xlabel="(estimate − truth)/standard error")
    shape.set_title("MOAV: normal at small m", fontsize=10, loc="left", color=INK, fontweight="bold")
    _legend(shape, "upper right")
    sd, error = avar.std(axis=0) / truth, 1 / np.sqrt(2 * records)
    spread.plot(m, np.sqrt(2 / exact), color=MODEL.light, linewidth=1.8, label="√(long-run variance/M)")
    spread.errorbar(m, sd, yerr=3 * sd * error, fmt=".", color=INK, markersize=5, label=f"{records} records")
    naive = 1 / np.sqrt(2 * (n / m - 1))
    spread.plot(m, naive, color=_COLOURS[0], linewidth=1.2, dashes=(4, 2), label="1/√(2(n/m − 1))")
    _log_axes(
        spread,
        "long-run variance",
        ("averaging factor m", "standard error/truth"),
        (0.8, 1.3 * m[-1]),
        (8e-3, 1.5),
    )
    _legend(spread, "lower right")
    names = {
        "imucal": "χ², EDF (imucal)",
        "exact": "normal, exact variance",
        "counted": "normal, 1/√(2(n/m−1))",
    }
    for (name, text), colour in zip(names.items(), (MODEL.light, FADED, _COLOURS[0]), strict=True):
        cover.plot(m, 100 * held[name], ".-", color=colour, markersize=5, linewidth=1.3, label=text)
    cover.axhline(95, color=INK, linewidth=0.8, dashes=(3, 2))
    cover.set_xscale("log")
    cover.set_xticks([1, 10, 100, 1000], labels=["1", "10", "100", "1000"])
    cover.set(xlabel="averaging factor m", ylabel="% of 95 % intervals that hold", ylim=(45, 102))
    cover.set_title("coverage", fontsize=10, loc="left", color=INK, fontweight="bold")
    _legend(cover, "lower left")
    for axes in (shape, cover):
        axes.tick_params(labelsize=_SIZE, colors=INK)
        axes.xaxis.label.set(fontsize=LABEL_SIZE, color=INK)
        axes.yaxis.label.set(fontsize=LABEL_SIZE, color=INK)
        axes.spines[["top", "right"]].set_visible(False)
    below = float(ndtri(0.975)) * np.sqrt(2 / exact) > 1
    least = float(np.min(exact / chdtri(exact, 0.025)))
    first = int(m[np.argmax(below)])
    print(f"normal limits lie below 0 from m = {first} on; chi-square's least is {least:.2g} of the estimate")
    print("coverage of imucal's intervals:", (100 * held["imucal"]).round(1).tolist())
    return figure


def slopes_figure(n: int = 100_000) -> Figure:
    """Draw the chapter's two records, n = 1e5: slopes -1/2 and +1/2."""
    figure, panels = _panels(2)
    cases = (
        ("N=1", "white noise, σ² = 1"),
        ("N=10 + K=0.03", "white noise, σ² = 100, walk, γ² = 9·10⁻⁴"),
    )
    for axes, (text, title) in zip(panels, cases, strict=True):
        model = NoiseModel.parse(text)
        samples = model.simulate(n, rate_hz=1.0, rng=np.random.default_rng(84))
        curve = allan_curve(AxisSeries.from_samples(samples, rate_hz=1.0), taus="decade:12")
        low, high = curve.confidence_interval(0.95)
        axes.fill_between(curve.tau, low, high, color=DATA.light, alpha=0.2, linewidth=0)
        axes.plot(
            curve.tau, curve.adev, ".-", color=DATA.light, markersize=4, linewidth=0.8, label="record, 95 %"
        )
        tau = np.unique(np.geomspace(1, n / 2, 200).round())
        axes.plot(tau, model.terms[0].coefficient / np.sqrt(tau), color=_COLOURS[0], dashes=(6, 2),
                  linewidth=1.2, label="slope −1/2: σ/√τ")  # fmt: skip
        if len(model.terms) > 1:
            walk = model.terms[1].coefficient * np.sqrt(tau / 3)
            axes.plot(
                tau, walk, color=_COLOURS[2], dashes=(10, 3), linewidth=1.2, label="slope +1/2: γ√(τ/3)"
            )
        axes.plot(
            tau,
            np.sqrt(model.avar(tau, rate_hz=1.0)),
            color=MODEL.light,
            linewidth=5,
            alpha=0.35,
            label="truth",
        )
        limits = (float(curve.adev.min()) / 2.5, float(curve.adev.max()) * 2)
        _log_axes(axes, title, ("averaging time τ (samples)", "Allan deviation"), (0.8, n / 2), limits)
        _legend(axes, "lower left" if len(model.terms) == 1 else "upper center")
    return figure


def latent_figure(n: int = 720_000) -> Figure:
    """Draw the bias of a simulated gyroscope over two hours, with a gap."""
    model = NoiseModel.parse("N=1e-4 + B=3e-5 + K=3e-6")
    samples = model.simulate(n, rate_hz=100.0, rng=np.random.default_rng(85))
    keep = np.ones(n, dtype=bool)
    keep[int(0.4 * n) : int(0.45 * n)] = False
    series = AxisSeries.from_samples(samples, rate_hz=100.0).keeping(keep)
    figure = bias_figure(decompose(series, model), source="simulated: N=1e-4 + B=3e-5 + K=3e-6")
    figure.set_dpi(95)
    return figure


#: Name of the picture -> function that draws it.
FIGURES: dict[str, Callable[[], Figure]] = {
    "theory-ma1": moving_average_figure,
    "theory-additivity": additivity_figure,
    "theory-ambiguity": ambiguity_figure,
    "theory-coverage": coverage_figure,
    "theory-slopes": slopes_figure,
    "theory-latent": latent_figure,
}


def estimators_table(records: int = 60, n: int = 100_000) -> None:
    """Print how slope reading, GMWM and maximum likelihood estimate the chapter's second record."""
    model = NoiseModel.parse("N=10 + K=0.03")
    rng = np.random.default_rng(86)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in ("slope", "gmwm", "mle")}
    seconds = dict.fromkeys(found, 0.0)
    for _ in range(records):
        series = AxisSeries.from_samples(model.simulate(n, rate_hz=1.0, rng=rng), rate_hz=1.0)
        curve = allan_curve(series)
        for name, values in found.items():
            begin = time.process_time()
            result = fit(series, model="N + K", method=name, curve=curve)
            seconds[name] += time.process_time() - begin
            values.append((result["N"].value or np.nan, result["K"].value or np.nan))
    print("| method | N: bias, RMSE % | K: bias, RMSE % | K read | CPU s |\n|---|---|---|---|---|")
    for name, values in found.items():
        off = 100 * (np.array(values) / [10, 0.03] - 1)
        with np.errstate(invalid="ignore"):
            bias, rmse = np.nanmean(off, axis=0), np.sqrt(np.nanmean(off**2, axis=0))
        shown = np.mean(np.isfinite(off[:, 1]))
        print(f"| `{name}` | {bias[0]:+.2f}, {rmse[0]:.2f} | {bias[1]:+.1f}, {rmse[1]:.1f} "
              f"| {100 * shown:.0f} % | {seconds[name] / records:.2f} |")  # fmt: skip


def likelihood_table() -> None:
    """Print the time of one likelihood with a dense covariance and of a complete fit, for rising n."""
    model = NoiseModel.parse("N=10 + K=0.03")
    print("| n | one dense likelihood, s | the whole fit, s |\n|---|---|---|")
    for n in (1000, 4000, 10_000, 100_000, 1_000_000, 10_000_000):
        samples = model.simulate(n, rate_hz=1.0, rng=np.random.default_rng(87))
        dense = "–"
        if n <= 4000:
            begin, t = time.process_time(), np.arange(n)
            covariance = 100 * np.eye(n) + 9e-4 * (1 + np.minimum.outer(t, t))
            lower = np.linalg.cholesky(covariance)
            np.linalg.solve(lower, samples)
            dense = f"{time.process_time() - begin:.2f}"
        series = AxisSeries.from_samples(samples, rate_hz=1.0)
        begin = time.process_time()
        fit(series, model="N + K")
        print(f"| {n:.0e} | {dense} | {time.process_time() - begin:.2f} |")


def main() -> None:
    """Write the pictures, print the tables."""
    default = Path(__file__).parents[2] / "docs" / "images"
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    for name, draw in FIGURES.items():
        (folder / f"{name}.png").write_bytes(render(draw(), "png"))
    estimators_table()
    likelihood_table()


if __name__ == "__main__":
    main()
