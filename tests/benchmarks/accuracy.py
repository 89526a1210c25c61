"""Monte Carlo study of the fit: bias, error relative to the Cramér-Rao bound, coverage, selection.

    python tests/benchmarks/accuracy.py settings --n 1000000 --repeats 200
    python tests/benchmarks/accuracy.py filters --n 262144 --repeats 100
    python tests/benchmarks/accuracy.py selection --n 1000000 --repeats 100
    python tests/benchmarks/accuracy.py gaps --n 65536 --repeats 100
    python tests/benchmarks/accuracy.py exact --n 20000 --repeats 20

Each command prints a table in Markdown; `docs/results/accuracy.md` contains the latest ones. The seed of a
row depends on the command, the row and `--seed`, so that rows can be run separately.
"""

import argparse
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import signal

from imucal.allan.curve import AllanCurve
from imucal.arrays import FloatArray
from imucal.fitting import FitSettings
from imucal.fitting.noise_fit import NoiseFit
from imucal.fitting.spectral import fit_mle, spectral_view
from imucal.fitting.spectral.likelihood import covariance, evaluate
from imucal.fitting.spectral.models import models_of
from imucal.fitting.spectral.ordinates import LAWS
from imucal.fitting.spectral.selection import choose
from imucal.noise.model import NoiseModel, parse_structure
from imucal.noise.term import PowerLawTerm
from imucal.noise.terms import GaussMarkov
from imucal.recording import AxisSeries
from tests.fitting.fits import ordinates_of

#: Settings of the study: per-sample units, sampling period 1 s.
SETTINGS = {
    "A": "N=1 + K=1e-3",
    "B": "N=1 + GM(sigma=0.1, T=500)",
    "C": "Q=1.7320508075688772 + N=1 + K=1e-3",
    "D": "N=1 + B=0.06324555320336758 + K=5.477225575051661e-4",
    "E": "N=1 + GM(sigma=0.22360679774997896, T=50) + GM(sigma=0.1, T=3000) + K=3.1622776601683795e-4",
    "F": "N=1 + R=1e-6",
}
#: F's ramp is smaller in a longer record, so that it is equally hard to detect.
RAMP_AT_MILLION = "N=1 + R=3e-8"

SELECTION = {
    "N": "N=1",
    "N + K": SETTINGS["A"],
    "N + GM": SETTINGS["B"],
    "Q + N + K": SETTINGS["C"],
    "N + B": "N=1 + B=0.06324555320336758",
    "N + B + K": SETTINGS["D"],
    "N + GM + K": "N=1 + GM(sigma=0.1, T=500) + K=3.1622776601683795e-4",
    "Q + N + B": "Q=1.7320508075688772 + N=1 + B=0.06324555320336758",
    "N + 2*GM + K": SETTINGS["E"],
}


def _one_pole(corner: float) -> tuple[FloatArray, FloatArray]:
    pole = np.exp(-np.pi * corner)
    return np.array([1 - pole]), np.array([1.0, -pole])


def _cascade(corner: float) -> tuple[FloatArray, FloatArray]:
    top, bottom = _one_pole(corner)
    return np.convolve(top, top), np.convolve(bottom, bottom)


def _resonance(place: float, radius: float) -> tuple[FloatArray, FloatArray]:
    bottom = np.array([1.0, -2 * radius * np.cos(np.pi * place), radius**2])
    return np.array([bottom.sum()]), bottom


def _biquad(corner: float, quality: float) -> tuple[FloatArray, FloatArray]:
    """Return the low-pass biquad of the audio cookbook, with a resonance for quality > 0.7."""
    w = np.pi * corner
    alpha, c = np.sin(w) / (2 * quality), np.cos(w)
    top = np.array([(1 - c) / 2, 1 - c, (1 - c) / 2])
    bottom = np.array([1 + alpha, -2 * c, 1 - alpha])
    return top / bottom[0], bottom / bottom[0]


def _mean(length: int) -> tuple[FloatArray, FloatArray]:
    return np.ones(length) / length, np.ones(1)


#: Output filters; corners are fractions of the Nyquist frequency. The method was designed on one-pole
#: and Butterworth responses; the others are held out.
FILTERS = {
    "none": (np.ones(1), np.ones(1)),
    "one-pole 0.5": _one_pole(0.5),
    "one-pole 0.2": _one_pole(0.2),
    "one-pole 0.1": _one_pole(0.1),
    "one-pole 0.05": _one_pole(0.05),
    "exponential mean 0.3": (np.array([0.3]), np.array([1.0, -0.7])),
    "Butterworth-1 0.3": signal.butter(1, 0.3),
    "Butterworth-2 0.9": signal.butter(2, 0.9),
    "Butterworth-2 0.3": signal.butter(2, 0.3),
    "Butterworth-4 0.5": signal.butter(4, 0.5),
    "Butterworth-4 0.2": signal.butter(4, 0.2),
    "Bessel-3 0.25": signal.bessel(3, 0.25),
    "Chebyshev-3 0.4": signal.cheby1(3, 0.5, 0.4),
    "two one-poles 0.3": _cascade(0.3),
    "two one-poles 0.1": _cascade(0.1),
    "resonance 0.3": _resonance(0.3, 0.8),
    "biquad 0.3, Q=2": _biquad(0.3, 2.0),
    "biquad 0.4, Q=0.5": _biquad(0.4, 0.5),
    "mean of 4": _mean(4),
    "mean of 16": _mean(16),
    "FIR-31 0.5": (signal.firwin(31, 0.5), np.ones(1)),
}


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Results of repeated fits of one truth: relative errors and hits, shape (repeats, p)."""

    names: list[str]
    errors: FloatArray
    hits: FloatArray
    bound: FloatArray
    chosen: Counter[str]


def truth_of(model: NoiseModel) -> dict[str, float]:
    """Return a model's parameters by the names that a fit uses."""
    values: dict[str, float] = {}
    count = sum(term.symbol == "GM" for term in model.terms)
    seen = 0
    for term in model.terms:
        if isinstance(term, GaussMarkov):
            seen += 1
            key = "GM" if count == 1 else f"GM{seen}"
            values |= {f"{key}.sigma": term.sigma, f"{key}.T": term.T}
        else:
            values[term.symbol] = term.coefficient
    return values


def cramer_rao(model: NoiseModel, n: int) -> FloatArray:
    """Return the minimal relative standard errors of an unbiased estimator, shape (p,)."""
    structure = parse_structure(str(model))
    ordinates = ordinates_of(np.random.default_rng(0).standard_normal(n))
    own = models_of([structure], ordinates.names)
    theta = np.full((1, own.width), -60.0)
    markov = [term for term in model.terms if isinstance(term, GaussMarkov)]
    for term in model.terms:
        if isinstance(term, PowerLawTerm):
            theta[0, [law.value for law in LAWS].index(term.symbol)] = np.log(term.variance(1.0))
    for index, gm in enumerate(markov):
        theta[0, 4 + index] = 2 * np.log(gm.sigma)
        theta[0, 4 + len(markov) + index] = np.log(gm.T)
    found = evaluate(ordinates, own, theta)
    inverse = covariance(found.information[0], own.free[0])
    values = truth_of(model)
    bounds = {
        name: (1.0 if name.endswith(".T") else 0.5) * float(np.sqrt(inverse[column, column]))
        for name, column in found.columns()
    }
    if "R" in values:
        bounds["R"] = float(np.sqrt(found.beta_covariance[0, 0, 0])) / values["R"]
    return np.array([bounds[name] for name in values])


def fitted(samples: FloatArray, model: str | None, criterion: str = "bic", max_gm: int = 2) -> NoiseFit:
    """Return the fit without a curve, which it does not use."""
    two = np.array([1.0, 2.0])
    curve = AllanCurve(tau=two, m=np.array([1, 2]), avar=two, edf=two, n=samples.size)
    return fit_mle(
        AxisSeries.from_samples(samples, rate_hz=1.0),
        curve,
        FitSettings(model=model or "auto", criterion=criterion, max_gm=max_gm),
    )


def _maximum(samples: FloatArray, model: str, key: str) -> float:
    """Return the estimate of a bounded term before it is dropped: the maximum of its likelihood."""
    structure = parse_structure(model)
    view = spectral_view(AxisSeries.from_samples(samples, rate_hz=1.0), FitSettings(model=model), None)
    choice = choose(
        view.ordinates,
        [structure],
        criterion="bic",
        band=view.band,
    )
    if key == "R":
        return float(abs(choice.fits.beta[0, 0])) * view.blocks.scale
    column = dict(choice.fits.columns())[f"{key}.sigma" if key.startswith("GM") else key]
    return float(np.exp(choice.fits.theta[0, column] / 2)) * view.blocks.scale


def cell(samples: Iterator[FloatArray], model: NoiseModel, n: int, *, choose: bool) -> Cell:
    """Fit the true structure to each series, and let the fit choose a structure on request."""
    values = truth_of(model)
    errors, hits, chosen = [], [], Counter[str]()
    for series in samples:
        result = fitted(series, str(model))
        error, hit = [], []
        for name, truth in values.items():
            key, _, part = name.partition(".")
            estimate = next((e for e in result.estimates if e.key == key), None)
            if estimate is None:
                error.append(np.nan)
                hit.append(False)
            elif part == "T":
                time = estimate.correlation_time
                error.append(np.nan if time is None else time.value / truth - 1)
                hit.append(time is not None and time.low <= truth <= time.high)
            else:
                value = estimate.value
                error.append((_maximum(series, str(model), key) if value is None else value) / truth - 1)
                hit.append(estimate.low <= truth <= estimate.high)
        errors.append(error)
        hits.append(hit)
        if choose:
            chosen[str(fitted(series, None).model)] += 1
    return Cell(
        names=list(values),
        errors=np.array(errors),
        hits=np.array(hits, dtype=np.float64),
        bound=cramer_rao(model, n),
        chosen=chosen,
    )


def _seed(*parts: object) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32("|".join(map(str, parts)).encode()))


def _rows(name: str, found: Cell) -> None:
    rmse = np.sqrt(np.nanmean(found.errors**2, axis=0))
    for i, parameter in enumerate(found.names):
        print(
            f"| {name if i == 0 else ''} | {parameter} | {100 * found.bound[i]:.3g} "
            f"| {100 * np.nanmean(found.errors[:, i]):+.2g} | {rmse[i] / found.bound[i]:.2f} "
            f"| {100 * np.mean(found.hits[:, i]):.1f} |",
            flush=True,
        )


def _header(n: int, repeats: int, first: str) -> None:
    print(f"\nn = {n}, {repeats} repeats\n")
    print(f"| {first} | parameter | CRB % | bias % | RMSE/CRB | coverage % |")
    print("|---|---|---|---|---|---|", flush=True)


def settings(n: int, repeats: int, seed: int, only: list[str]) -> None:
    """Print bias, error and coverage of the settings A to F."""
    _header(n, repeats, "setting")
    for name, text in SETTINGS.items():
        if only and name not in only:
            continue
        model = NoiseModel.parse(RAMP_AT_MILLION if name == "F" and n >= 10**6 else text)
        rng = _seed("settings", name, n, seed)
        series = (model.simulate(n, rate_hz=1.0, rng=rng) for _ in range(repeats))
        _rows(name, cell(series, model, n, choose=False))


def filters(n: int, repeats: int, seed: int, only: list[str]) -> None:
    """Print bias, error and coverage of N + B + K behind output filters."""
    _behind_filters("D", n, repeats, seed, only)


def filters_gm(n: int, repeats: int, seed: int, only: list[str]) -> None:
    """Print bias, error and coverage of N + GM behind output filters."""
    _behind_filters("B", n, repeats, seed, only)


def _behind_filters(setting: str, n: int, repeats: int, seed: int, only: list[str]) -> None:
    _header(n, repeats, "filter")
    model = NoiseModel.parse(SETTINGS[setting])
    for name, (top, bottom) in FILTERS.items():
        if only and name not in only:
            continue
        rng = _seed("filters", name, n, seed)

        def series(
            rng: np.random.Generator = rng, top: FloatArray = top, bottom: FloatArray = bottom
        ) -> Iterator[FloatArray]:
            settle = 4096
            for _ in range(repeats):
                raw = model.simulate(n + settle, rate_hz=1.0, rng=rng)
                yield np.asarray(signal.lfilter(top, bottom, raw - raw[0]))[settle:]

        _rows(name, cell(series(), model, n, choose=False))


def selection(n: int, repeats: int, seed: int, only: list[str]) -> None:
    """Print how often each criterion finds the true structure."""
    print(f"\nn = {n}, {repeats} repeats\n")
    print("| truth | BIC | HQ | AIC | most common other choice (BIC) |")
    print("|---|---|---|---|---|")
    for name, text in SELECTION.items():
        if only and name not in only:
            continue
        model = NoiseModel.parse(text)
        rng = _seed("selection", name, n, seed)
        counts = {criterion: Counter[str]() for criterion in ("bic", "hq", "aic")}
        for _ in range(repeats):
            samples = model.simulate(n, rate_hz=1.0, rng=rng)
            for criterion, counter in counts.items():
                counter[str(fitted(samples, None, criterion).model)] += 1
        shares = " | ".join(f"{c[name] / repeats:.2f}" for c in counts.values())
        others = [item for item in counts["bic"].most_common() if item[0] != name]
        other = f"{others[0][0]} {others[0][1] / repeats:.2f}" if others else "–"
        print(f"| {name} | {shares} | {other} |", flush=True)


def gaps(n: int, repeats: int, seed: int, only: list[str]) -> None:
    """Print bias, error and coverage of N + K with missing samples."""
    _header(n, repeats, "gaps")
    model = NoiseModel.parse("N=1 + K=3.1622776601683795e-3")
    for name in ("none", "10 % scattered", "20 bursts of 0.5 %", "5 bursts of 4 %"):
        if only and name not in only:
            continue
        rng = _seed("gaps", name, n, seed)

        def series(rng: np.random.Generator = rng, name: str = name) -> Iterator[FloatArray]:
            for _ in range(repeats):
                samples = model.simulate(n, rate_hz=1.0, rng=rng)
                samples[_missing(name, n, rng)] = np.nan
                yield samples

        values = truth_of(model)
        errors, hits = [], []
        for samples in series():
            data = AxisSeries.from_samples(samples, rate_hz=1.0).finite()
            two = np.array([1.0, 2.0])
            curve = AllanCurve(tau=two, m=np.array([1, 2]), avar=two, edf=two, n=n)
            result = fit_mle(data, curve, FitSettings(model="N + K", max_gm=0))
            errors.append([(result[k].value or 0.0) / v - 1 for k, v in values.items()])
            hits.append([result[k].low <= v <= result[k].high for k, v in values.items()])
        found = Cell(
            names=list(values),
            errors=np.array(errors),
            hits=np.array(hits, dtype=np.float64),
            bound=cramer_rao(model, n),
            chosen=Counter(),
        )
        _rows(name, found)


def _missing(name: str, n: int, rng: np.random.Generator) -> np.typing.NDArray[np.bool_]:
    missing = np.zeros(n, dtype=bool)
    if name == "10 % scattered":
        return rng.random(n) < 0.1
    count, share = {"none": (0, 0.0), "20 bursts of 0.5 %": (20, 0.005), "5 bursts of 4 %": (5, 0.04)}[name]
    length = int(share * n)
    for start in rng.integers(0, n - length, count) if count else ():
        missing[start : start + length] = True
    missing[0] = missing[-1] = False
    return missing


def exact(n: int, repeats: int, seed: int, only: list[str]) -> None:
    """Print the distance to the exact likelihood's maximum, in standard errors."""
    from tests.fitting.state_space import distances

    print(f"\nn = {n}, {repeats} repeats\n\n| setting | median | greatest |\n|---|---|---|")
    for name, text in SETTINGS.items():
        if name not in (only or ["A", "B", "C"]):
            continue
        model = NoiseModel.parse(text)
        rng = _seed("exact", name, n, seed)
        worst = []
        for _ in range(repeats):
            samples = model.simulate(n, rate_hz=1.0, rng=rng)
            result = fitted(samples, str(model))
            series = AxisSeries.from_samples(samples, rate_hz=1.0)
            worst.append(max(distances(series, result.model, result.parameters, result.covariance).values()))
        print(f"| {name} | {np.median(worst):.3f} | {np.max(worst):.3f} |", flush=True)


def main() -> None:
    """Run one of the tables."""
    tables = {t.__name__: t for t in (settings, filters, filters_gm, selection, gaps, exact)}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("table", choices=tables)
    parser.add_argument("--n", type=lambda text: int(float(text)), default=100_000)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--only", nargs="*", default=[])
    options = parser.parse_args()
    tables[options.table](options.n, options.repeats, options.seed, options.only)


if __name__ == "__main__":
    main()
