"""characterize: Recording -> Report, axis by axis. No input, no output."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from itertools import chain
from typing import TypeAlias

import numpy as np

from imucal._version import __version__
from imucal.advice import advised_report
from imucal.allan import Spectrum, allan_curve, spectrum
from imucal.allan.dct import Transform
from imucal.arrays import FloatArray, never_changes
from imucal.errors import ArgumentError, DataError
from imucal.findings import Finding, as_sentence
from imucal.fitting import FitSettings, NoiseFit, fit_axis
from imucal.fitting.cross_checks import (
    ambiguity_findings,
    filtered_curve_findings,
    fit_of_curve,
    second_opinion,
)
from imucal.fitting.robust import clean
from imucal.fitting.spectral.blocks import no_noise
from imucal.fitting.spectral.disturbances.not_noise import not_noise
from imucal.grading import is_motion
from imucal.parallel import side_by_side
from imucal.planning import resolution_findings
from imucal.recording import AxisSeries, ReadRange, Recording, Temperature
from imucal.report.result import AxisReport, Overview, Report
from imucal.resources import memory_limit, threads
from imucal.screening import screen_values, worst_first
from imucal.side_work import findings_or_why_not

#: Samples from which constant axes are refused early.
_BLOCK = 1 << 20
#: Samples per block, small enough for the cache.
_PART = 1 << 15
#: Memory of the analysis of an axis, in bytes per sample.
_BYTES = 24
#: Memory of the analysis of an axis besides its samples, in bytes.
_BESIDES = 25_000_000
#: Default limit of the memory of all parallel axes, in bytes.
_ROOM = 300_000_000
#: Below this number of samples, screening is faster than forking.
_LONG = 500_000
#: Lazily loaded modules that every axis needs.
_MODULES = ("scipy.fft", "scipy.special", "imucal.fitting.moments")
#: In the order of report.json; `reading` comes last.
_DOCUMENTED = (
    *("model", "method", "level", "criterion", "weights", "taus"),
    *("max_gm", "clean", "second_opinion", "segments"),
)

_MIN_TEMPERATURES = 16

Progress: TypeAlias = Callable[[int, int, str], None]


@dataclass(frozen=True, kw_only=True)
class Settings(FitSettings):
    """Settings of `characterize`; see `imucal.fit` and `imucal.allan_curve`.

    `reading` contains the options of reading the log as JSON values, for the report.
    """

    taus: str = "octave"
    second_opinion: bool = False
    reading: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        FitSettings.__post_init__(self)
        if self.second_opinion and self.method != "mle":
            msg = (
                f"a second opinion compares method mle with the curve; omit it, or omit method {self.method}"
            )
            raise ArgumentError(msg)

    def document(self) -> dict[str, object]:
        return {name: getattr(self, name) for name in _DOCUMENTED} | {"reading": dict(self.reading)}


def characterize(
    recording: Recording,
    settings: Settings | None = None,
    *,
    progress: Progress | None = None,
    workers: int | None = None,
) -> Report:
    """Screen a recording and fit a noise model to every axis.

    An axis that can't be analysed is left out and reported in a finding. If the IMU was moved, there is no
    search for a model: the slopes of the curve are read.

    Parameters
    ----------
    settings
        By default `Settings()`.
    progress
        Called with the number of finished axes, the number of all axes, and the name of the next one.
    workers
        Maximum number of axes at a time, each in a forked child process; at least 1. By default the number of
        processors (see ``IMUCAL_THREADS``), limited to 300 MB in addition to the samples and to the memory of
        one step (see ``IMUCAL_MEMORY``); 1 if processes can't be forked safely: not on Linux, with other
        threads, inside a child of other parallel work, under a debugger. The result does not depend on it.

    Raises
    ------
    DataError
        If no axis can be analysed.
    ValueError
        If a setting is unknown, or `workers` is less than 1.
    """
    settings = settings or Settings()
    workers = _workers(recording, workers)
    # Import once, before forking.
    list(map(import_module, _MODULES))
    # A fit by maximum likelihood reports disturbances itself.
    look = screen_values if settings.method == "mle" else screen
    long = max((series.n for series in recording.series), default=0) >= _LONG
    findings = recording.findings + look(recording, workers=workers if long else 1)

    used = _for_motion(settings, findings)

    def work(series: AxisSeries) -> AxisReport | DataError:
        try:
            return _characterize_axis(series, used, recording.temperature, findings)
        except DataError as error:
            return error.at(series.name)

    def report_done(done: int, following: AxisSeries | None) -> None:
        if progress:
            progress(done, len(recording.series), following.name if following else "")

    found = side_by_side(work, recording.series, workers=workers, done=report_done)
    axes = [axis for axis in found if isinstance(axis, AxisReport)]
    failures = [failure for failure in found if isinstance(failure, DataError)]
    if not axes:
        reasons = _reasons(failures) or "the log has no samples"
        problem = f"no axis can be analysed: {reasons}"
        raise DataError(problem, place=recording.source.path, code="no-result")
    report = Report(
        source=replace(recording.source, read=recording.source.read or ReadRange.of(recording.series)),
        axes=tuple(axes),
        settings=settings.document(),
        version=__version__,
        findings=tuple(_of_no_result(findings, axes, failures)),
    )
    return advised_report(report, recording)


def _for_motion(settings: Settings, findings: Sequence[Finding]) -> Settings:
    """Return the settings for the fits; if the IMU moved, without the slow search for a model."""
    if not any(is_motion(finding) for finding in findings):
        return settings
    return replace(settings, method="slope", model="auto", second_opinion=False)


def _no_result(error: DataError, findings: Sequence[Finding]) -> Finding:
    """Return why an axis has no result, with the screening's advice about an axis without data."""
    axis = error.place
    advice = next((f.advice for f in findings if f.axis == axis and f.code == "no-data"), "")
    return Finding("error", "no-result", as_sentence(error.sentence), advice, axis=axis)


def _of_no_result(
    findings: Sequence[Finding], axes: Sequence[AxisReport], failures: Sequence[DataError]
) -> Iterator[Finding]:
    """Yield the findings without a result, then the failures, which replace `no-data` of their axes."""
    fitted, failed = {axis.name for axis in axes}, {failure.place for failure in failures}
    for finding in findings:
        if finding.axis not in fitted and (finding.code != "no-data" or finding.axis not in failed):
            yield finding
    for failure in failures:
        yield _no_result(failure, findings)


def screen(recording: Recording, *, workers: int = 1) -> tuple[Finding, ...]:
    """Return the problems of a recording, worst first; empty for a good one.

    Codes: ``absurd-rate``, ``fast-rate``, ``no-data``, ``not-finite``, ``stuck``, ``saturated``,
    ``held-samples``, ``coarse-lsb``, ``swapped-sensors``, ``duplicate-axes``, ``interleaved-sensors``,
    ``unit-suspect``, ``no-gravity``, ``motion``, ``touch``, and for an IMU at rest ``step``, ``cycle``,
    ``warm-up``, ``temperature``, ``tone``, ``roll-off``, which a fit by maximum likelihood removes and
    reports itself.
    Findings of the reader are not repeated. Up to `workers` axes are screened at a time; the findings do not
    depend on it.
    """
    findings = screen_values(recording, workers=workers)
    if any(is_motion(finding) for finding in findings):
        return findings

    def look(series: AxisSeries) -> tuple[Finding, ...]:
        finite = series.finite()
        return findings_or_why_not(
            lambda: not_noise(finite, _temperature_at(finite, recording.temperature)),
            what="The search for disturbances failed",
            code="not-checked",
            axis=series.name,
        )

    found = side_by_side(look, recording.series, workers=workers)
    return worst_first(recording, [*findings, *chain.from_iterable(found)])


def _workers(recording: Recording, wanted: int | None) -> int:
    if wanted is not None and wanted < 1:
        raise ArgumentError(f"workers must be at least 1, got {wanted}")
    largest = max((series.n for series in recording.series), default=0)
    count, room = (threads(), min(memory_limit(), _ROOM)) if wanted is None else (wanted, memory_limit())
    return max(1, min(count, room // (_BESIDES + _BYTES * largest)))


def _reasons(failures: Sequence[DataError]) -> str:
    """Return why axes could not be analysed, axes with the same reason together."""
    axes: dict[str, list[str]] = {}
    for failure in failures:
        axes.setdefault(failure.sentence, []).append(failure.place)
    return "; ".join(f"{', '.join(names)}: {reason}" for reason, names in axes.items())


def _characterize_axis(
    series: AxisSeries, settings: Settings, temperature: Temperature | None, screened: tuple[Finding, ...]
) -> AxisReport:
    finite = series.finite()
    if not finite.n:
        raise DataError(
            f"no usable samples among {series.n}: all are NaN, infinite or absurdly large",
            place=series.name,
        )
    # Saves time and memory for a long axis.
    if finite.n > _BLOCK and never_changes(finite.samples):
        raise no_noise(finite)
    at_samples = _temperature_at(finite, temperature)
    transform = Transform.of(finite)
    curve = allan_curve(finite, taus=settings.taus, transform=transform)
    density = spectrum(finite, transform=transform)
    result = fit_axis(finite, settings, temperature=at_samples, curve=curve, transform=transform)
    # The rest does not need it, but memory.
    del transform
    opinions: tuple[Finding, ...] = ()
    if settings.second_opinion and settings.method == "mle" and result.model.terms:
        opinions = _second_opinion(finite, result, at_samples)
    findings = [f for f in screened if f.axis == series.name]
    if not any(is_motion(finding) for finding in screened):
        # If the IMU moved, only the findings of the screening are useful.
        found = (*_of_fit(result, finite, density), *opinions)
        if settings.method != "mle":
            found += filtered_curve_findings(screened, settings.method, series.name)
        findings += [replace(finding, axis=series.name) for finding in found]
    mean, std = _moments(finite.samples)
    overview = Overview.of(finite)
    return AxisReport(
        sensor=series.sensor,
        axis=series.axis,
        samples=finite.n,
        rate_hz=finite.rate_hz,
        duration_s=finite.duration_s,
        mean=mean,
        std=std,
        gaps=finite.clock.gaps,
        spectrum=density,
        overview=overview,
        fit=result,
        findings=tuple(dict.fromkeys(findings)),
    )


def _of_fit(result: NoiseFit, series: AxisSeries, density: Spectrum) -> tuple[Finding, ...]:
    return (
        *result.findings,
        *findings_or_why_not(
            lambda: resolution_findings(result, series.n * series.tau0),
            what="The required record length is unknown",
            code="record-length",
        ),
        *findings_or_why_not(
            lambda: ambiguity_findings(result, density, series.name),
            what="The ambiguity of the curve is unknown",
            code="spectral-ambiguity",
        ),
    )


def _second_opinion(
    series: AxisSeries, first: NoiseFit, temperature: FloatArray | None
) -> tuple[Finding, ...]:
    """Compare with a fit of the Allan curve."""
    if any(finding.code == "spikes" for finding in first.findings):
        series = clean(series)[0]
    return findings_or_why_not(
        lambda: second_opinion(first, fit_of_curve(series, first, temperature)),
        what="The fit of the Allan curve failed",
        code="second-opinion",
        axis=series.name,
    )


def _moments(samples: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation without a copy of the samples, which may be in a mapped file."""
    mean = float(np.mean(samples))
    parts = (samples[start : start + _PART] - mean for start in range(0, samples.size, _PART))
    return mean, float(np.sqrt(sum(float(np.sum(part * part)) for part in parts) / samples.size))


def _temperature_at(series: AxisSeries, temperature: Temperature | None) -> FloatArray | None:
    """Return the temperature at each sample, interpolated; None if it is hardly known."""
    if temperature is None:
        return None
    known, clock = np.isfinite(temperature.samples), temperature.clock
    if np.count_nonzero(known) < _MIN_TEMPERATURES:
        return None
    if clock is series.clock and known.all():
        return temperature.samples
    at, seconds = series.clock.grid() * series.tau0, clock.grid()[known] * clock.tau0
    if series.clock.start_ns is not None and clock.start_ns is not None:
        at += (series.clock.start_ns - clock.start_ns) / 1e9
    return np.asarray(np.interp(at, seconds, temperature.samples[known]))
