"""Reports with known truth, built from noise models without reading or fitting.

Curves are theoretical with chi-squared scatter, so a report takes milliseconds and all its numbers are known.
"""

from dataclasses import replace

import numpy as np

from imucal.allan.curve import AllanCurve
from imucal.allan.dct import Spectrum
from imucal.clock import Gap
from imucal.findings import Finding
from imucal.fitting.noise_fit import Candidate, Estimate, Goodness, Interval, Line, NoiseFit, Response
from imucal.noise.model import NoiseModel
from imucal.noise.term import NoiseTerm
from imucal.noise.terms import GaussMarkov
from imucal.recording import Axis, Sensor, Source
from imucal.report.result import AxisReport, Overview, Report

__all__ = ["axis_report", "consumer_report", "shortest_report", "small_report"]

_RATE_HZ = 200.0
_HOURS = 3.0


def axis_report(
    sensor: Sensor,
    axis: Axis,
    model_text: str,
    *,
    bounds: dict[str, float] | None = None,
    rate_hz: float = _RATE_HZ,
    n: int = int(_HOURS * 3600 * _RATE_HZ),
    mean: float = 0.0,
    band_hz: tuple[float, float] | None = None,
    tau_s: tuple[float, float] | None = None,
    lines: tuple[Line, ...] = (),
    response: Response | None = None,
    gaps: tuple[Gap, ...] = (),
    findings: tuple[Finding, ...] = (),
    fit_findings: tuple[Finding, ...] = (),
    relative_error: float = 0.02,
    overview_size: int = 400,
) -> AxisReport:
    """Return an axis whose fit found exactly `model_text`, with scatter around its curve."""
    rng = np.random.default_rng([len(model_text), ord(axis), sensor is Sensor.GYROSCOPE])
    model = NoiseModel.parse(model_text)
    curve = _curve(model, rate_hz, n, rng)
    used = np.arange(curve.tau.size)
    if band_hz is not None:
        used = np.flatnonzero(curve.tau >= 0.5 / band_hz[1])
    if tau_s is not None:
        used = np.flatnonzero((curve.tau >= tau_s[0]) & (curve.tau <= tau_s[1]))
    estimates = _estimates(model, bounds or {}, relative_error)
    parameters, covariance = _covariance(model, relative_error)
    goodness = Goodness(
        statistic=0.42, p_value=0.34, chi2_per_bin=1.012, band_hz=band_hz, tau_s=tau_s, lines=lines
    )
    fit = NoiseFit(
        method="mle" if tau_s is None else "gmwm",
        sensor=sensor,
        rate_hz=rate_hz,
        level=0.95,
        model=model,
        estimates=estimates,
        parameters=parameters,
        covariance=covariance,
        goodness=goodness,
        curve=curve,
        used=used,
        response=response,
        candidates=(Candidate(structure=str(model), delta=0.0), Candidate(structure="N + K", delta=3.7)),
        criterion="bic",
        findings=fit_findings,
        settings={"taus": "octave"},
    )
    white = float(np.sqrt(model.avar(np.ones(1), rate_hz=rate_hz)[0]))
    return AxisReport(
        sensor=sensor,
        axis=axis,
        samples=n,
        rate_hz=rate_hz,
        duration_s=n / rate_hz + sum(gap.duration_s for gap in gaps),
        mean=mean,
        std=white,
        gaps=gaps,
        spectrum=_spectrum(model, rate_hz, n, lines, response, rng),
        overview=_overview(n / rate_hz, mean, white, gaps, overview_size, rng),
        fit=fit,
        findings=findings,
    )


def consumer_report() -> Report:
    """Return a report with all features: bounds, gaps, lines, a filter, Gauss-Markov terms."""
    gap = Gap(start_s=4000.0, missing=24000, duration_s=120.0)
    tone = Finding(
        level="warning",
        code="tone",
        axis="gyro_x",
        text="A line stands at 49.97 Hz with an amplitude of 3.1e-05 rad/s.",
        advice="It looks like mains hum; the fit left it out.",
    )
    warm = Finding(
        level="warning",
        code="warm-up",
        axis="accel_z",
        text="The mean drifts by 0.021 m/s^2 in the first 14 minutes.",
        advice="Record after the sensor has warmed up, or keep the part from 840 s on.",
        keep_s=(840.0, 10800.0),
    )
    gyro, accel = Sensor.GYROSCOPE, Sensor.ACCELEROMETER
    band = (2e-4, 80.0)
    hum = (Line(frequency_hz=49.97, amplitude=3.1e-5), Line(frequency_hz=12.5, amplitude=1.2e-5))
    axes = (
        axis_report(
            gyro,
            "x",
            "N=1.2e-4 + B=2.4e-5 + K=1.1e-6",
            mean=2.1e-3,
            lines=hum,
            findings=(tone,),
            gaps=(gap,),
            band_hz=band,
        ),
        axis_report(
            gyro,
            "y",
            "N=1.3e-4 + B=2.1e-5",
            bounds={"K": 4.1e-7},
            mean=-4e-3,
            response=Response(cutoff_hz=46.0),
            gaps=(gap,),
            band_hz=(2e-4, 30.0),
        ),
        axis_report(
            gyro,
            "z",
            "N=1.1e-4 + GM(sigma=4e-5, T=90.0) + GM(sigma=6e-5, T=1500.0) + K=3e-7",
            bounds={"B": 6.2e-6},
            mean=1e-3,
            gaps=(gap,),
            band_hz=band,
        ),
        axis_report(accel, "x", "Q=2e-6 + N=1.1e-3 + B=2.9e-4 + K=9e-6", mean=0.11, band_hz=(2e-4, 100.0)),
        axis_report(accel, "y", "N=1.3e-3 + B=2.5e-4", bounds={"K": 5e-6}, mean=-0.2, tau_s=(0.04, 700.0)),
        axis_report(
            accel,
            "z",
            "N=1.9e-3 + B=3.1e-4 + K=1.9e-5 + R=2e-7",
            mean=9.79,
            findings=(warm,),
            fit_findings=(
                Finding(
                    level="info",
                    code="second-opinion",
                    axis="accel_z",
                    text="The curve's own fit (gmwm) agrees within 1.1 standard deviations.",
                ),
            ),
            band_hz=(1e-3, 100.0),
        ),
    )
    return Report(
        source=Source(
            path="logs/still_night.mcap",
            format="mcap",
            topics=("/imu/data",),
            message_types=("sensor_msgs/msg/Imu",),
            decisions=(("topic", "/imu/data, the only one of an IMU type"), ("stamps", "header stamp")),
        ),
        axes=axes,
        settings={"model": "auto", "method": "mle", "level": 0.95, "taus": "octave", "skip_s": None},
        findings=(
            Finding(
                level="info",
                code="gaps",
                text="1 gap of 120 s after 4000 s; the rest is unbroken.",
                advice="Nothing needs doing: curve and fit know about gaps.",
            ),
        ),
        version="0.1.0",
    )


def small_report() -> Report:
    """Return one short gyroscope axis with white noise and no other detected term."""
    axis = axis_report(
        Sensor.GYROSCOPE, "x", "N=0.001", bounds={"B": 3e-4, "K": 2e-4}, n=2000, overview_size=100
    )
    return replace(consumer_report(), axes=(axis,), findings=())


def shortest_report(n: int) -> Report:
    """Return an axis of a few samples, without detected terms and with unknown bounds."""
    bounds = {"B": 1.0, "K": 1.0}
    sensor = Sensor.ACCELEROMETER
    axis = axis_report(sensor, "z", "N=1e-3", bounds=bounds, n=n, rate_hz=10.0, overview_size=3)
    unknown = tuple(
        replace(estimate, status="bounded", value=None, low=0.0, high=np.inf)
        for estimate in axis.fit.estimates
    )
    fit = replace(
        axis.fit,
        model=NoiseModel(terms=()),
        estimates=unknown,
        parameters=(),
        covariance=np.zeros((0, 0)),
        used=axis.fit.used[:0],
        goodness=Goodness(statistic=np.nan, p_value=np.nan, chi2_per_bin=np.nan),
    )
    return replace(small_report(), axes=(replace(axis, fit=fit),))


def _curve(model: NoiseModel, rate_hz: float, n: int, rng: np.random.Generator) -> AllanCurve:
    m = 2 ** np.arange(int(np.log2(n / 2)) + 1)
    avar = model.avar(m.astype(np.float64), rate_hz=rate_hz)
    # Degrees of freedom similar to white noise; a vanishing scatter would hide drawing errors.
    edf = np.maximum(1.5 * n / (2 * m) * (2 * m * m) / (2 * m * m + 1.0) - 1, 1.0)
    scatter = rng.chisquare(edf) / edf
    return AllanCurve(
        tau=m / rate_hz, m=m, avar=avar * np.maximum(scatter, 0.2), edf=edf, n=n, edf_method="hybrid"
    )


def _spectrum(  # noqa: PLR0917 - a helper of one caller
    model: NoiseModel,
    rate_hz: float,
    n: int,
    lines: tuple[Line, ...],
    response: Response | None,
    rng: np.random.Generator,
) -> Spectrum:
    edges = np.unique(np.geomspace(1, n // 2, 140).astype(np.int64))
    middle = np.sqrt(edges[1:] * edges[:-1])
    frequency = middle * rate_hz / n
    count = np.maximum(np.diff(edges) * 2.0, 2.0)
    psd = model.psd(frequency, rate_hz=rate_hz)
    if response is not None:
        psd = psd / (1 + (frequency / response.cutoff_hz) ** 4)
    psd = psd * rng.chisquare(count) / count
    for line in lines:
        nearest = np.argmin(np.abs(frequency - line.frequency_hz))
        psd[nearest] += line.amplitude**2 / 4 * n / rate_hz / count[nearest]
    return Spectrum(frequency=frequency, psd=psd, count=count)


def _overview(  # noqa: PLR0917 - a helper of one caller
    duration_s: float, mean: float, std: float, gaps: tuple[Gap, ...], k: int, rng: np.random.Generator
) -> Overview:
    time = (np.arange(k) + 0.5) * duration_s / k
    drift = 0.3 * std * np.cumsum(rng.standard_normal(k)) / np.sqrt(k)
    low = mean + drift - std * (4.5 + 0.3 * rng.standard_normal(k))
    high = mean + drift + std * (4.5 + 0.3 * rng.standard_normal(k))
    for gap in gaps:
        inside = (time >= gap.start_s) & (time < gap.start_s + gap.duration_s)
        low[inside] = high[inside] = np.nan
    return Overview(time_s=time, low=low, high=high)


def _estimates(model: NoiseModel, bounds: dict[str, float], error: float) -> tuple[Estimate, ...]:
    width = 1.96 * error
    several = sum(isinstance(term, GaussMarkov) for term in model.terms) > 1
    found, count = [], 0
    for term in _by_correlation_time(model):
        key, time = term.symbol, None
        if isinstance(term, GaussMarkov):
            count += 1
            key = f"GM{count}" if several else "GM"
            time = Interval(value=term.T, low=term.T / (1 + 6 * width), high=term.T * (1 + 6 * width))
        value = term.coefficient
        # Walks and drifts have larger errors than white noise.
        wide = width * {"N": 0.1, "Q": 1.0, "B": 1.0, "GM": 2.0, "K": 4.0, "R": 5.0}[term.symbol]
        found.append(
            Estimate(
                key=key,
                symbol=term.symbol,
                status="estimated",
                value=value,
                low=value / (1 + wide),
                high=value * (1 + wide),
                correlation_time=time,
            )
        )
    for symbol, high in bounds.items():
        found.append(Estimate(key=symbol, symbol=symbol, status="bounded", value=None, low=0.0, high=high))
    order = ["Q", "N", "B", "GM", "GM1", "GM2", "K", "R"]
    return tuple(sorted(found, key=lambda e: order.index(e.key)))


def _by_correlation_time(model: NoiseModel) -> list[NoiseTerm]:
    """Return the terms, with Gauss-Markov terms sorted by T, as a fit names them."""
    return sorted(model.terms, key=lambda term: term.T if isinstance(term, GaussMarkov) else 0.0)


def _covariance(model: NoiseModel, error: float) -> tuple[tuple[str, ...], np.ndarray]:
    names: list[str] = []
    values: list[float] = []
    for term in _by_correlation_time(model):
        if isinstance(term, GaussMarkov):
            key = f"GM{sum(name.endswith('.T') for name in names) + 1}"
            names += [f"{key}.sigma", f"{key}.T"]
            values += [term.sigma, term.T]
        else:
            names.append(term.symbol)
            values.append(term.coefficient)
    deviations = error * np.array(values)
    correlation = 0.3 ** np.abs(np.subtract.outer(np.arange(len(values)), np.arange(len(values))))
    return tuple(names), correlation * np.outer(deviations, deviations)
