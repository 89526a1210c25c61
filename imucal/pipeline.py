"""characterize: Recording -> Report, axis by axis. No input, no output."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from importlib import import_module
from itertools import chain
from typing import TypeAlias

import numpy as np

from imucal._version import __version__
from imucal.advice import advised_report
from imucal.allan import Spectrum, allan_curve, spectrum
from imucal.allan.dct import shared_transform
from imucal.arguments import takes
from imucal.arrays import FloatArray, never_changes, release
from imucal.errors import ArgumentError, DataError
from imucal.findings import Finding
from imucal.fitting import FitSettings, NoiseFit, fit_axis
from imucal.fitting.cross_checks import ambiguity_findings, fit_of_curve, second_opinion
from imucal.fitting.robust import clean
from imucal.fitting.spectral.blocks import no_noise
from imucal.fitting.spectral.not_noise import not_noise
from imucal.frozen import frozen
from imucal.planning import resolution_findings
from imucal.prediction import self_check
from imucal.processes import findings_or_why_not, side_by_side
from imucal.recording import AxisSeries, ReadRange, Recording, Temperature
from imucal.report.result import AxisReport, Overview, Report
from imucal.resources import memory_limit, threads
from imucal.screening import screen_values, worst_first

#: Samples looked at at once, and so many that they stay in the cache.
_BLOCK, _PART = 1 << 20, 1 << 15
#: Bytes that the analysis of an axis takes for each of its samples and besides, and those that all axes may
#: take that are worked on at a time unless a number is wanted.
_BYTES, _BESIDES, _ROOM = 24, 25_000_000, 300_000_000
#: Shorter axes are screened in less time than a process is forked.
_LONG = 500_000
#: What every axis needs of modules that are loaded when they are used.
_MODULES = ("scipy.fft", "scipy.special", "imucal.fitting.moments")
#: The settings in the order of report.json; `reading` comes last.
_DOCUMENTED = (
    *("model", "method", "level", "criterion", "weights", "taus", "edf"),
    *("max_gm", "clean", "second_opinion", "segments", "bins"),
)

#: Fewest measured temperatures that say how an axis follows it.
_FEWEST_DEGREES = 16

#: Called with the number of axes done, of all axes, and the name of the next one.
Progress: TypeAlias = Callable[[int, int, str], None]


@frozen
class Settings(FitSettings):
    """How a recording is characterised; see `imucal.fit` and `imucal.allan_curve`.

    `reading` records how the log was read, as JSON values, so that the run can be repeated; with `bins`
    report.json holds the bins of each fit, which `imucal.pool` needs.
    """

    taus: str = "octave"
    edf: str = "hybrid"
    second_opinion: bool = True
    bins: bool = False
    reading: Mapping[str, object] = field(default_factory=dict)

    def document(self) -> dict[str, object]:
        """Return the settings as JSON values."""
        return {name: getattr(self, name) for name in _DOCUMENTED} | {"reading": dict(self.reading)}


Settings.__init__ = takes('imucal.Settings(model="N + B")')(Settings.__init__)  # type: ignore[method-assign]


@takes('imucal.characterize(imucal.read("log.mcap"))', recording=Recording, settings=(Settings, type(None)))
def characterize(
    recording: Recording,
    settings: Settings | None = None,
    *,
    progress: Progress | None = None,
    workers: int | None = None,
) -> Report:
    """Screen a recording and fit a noise model to every axis.

    An axis that can't be analysed is left out and named in a finding. If the IMU was moved, no model is
    searched for: the slopes of the curve are read.

    Parameters
    ----------
    recording
        What was measured.
    settings
        How; by default `Settings()`.
    progress
        Called with the number of axes done, of all, and the name of the next.
    workers
        Most axes at a time, each in a forked child process, at least 1; by default as many as this process
        has processors (see ``IMUCAL_THREADS``), and 300 MB hold beside the samples. Fewer where so many
        would take more memory than one step may (see ``IMUCAL_MEMORY``); one after the other where processes
        can't be forked safely: not on Linux, beside other threads of the program, inside a process of other
        parallel work, under a debugger.
        The result is the same for any number.

    Raises
    ------
    DataError
        If no axis can be analysed.
    ValueError
        If a setting is not known, or `workers` is less than 1.
    """
    settings = settings or Settings()
    workers = _workers(recording, workers)
    # Once, by the process that others are forked from.
    list(map(import_module, _MODULES))
    # What is not noise, a fit by maximum likelihood finds and says itself.
    look = screen_values if settings.method == "mle" else screen
    long = max((series.n for series in recording.series), default=0) >= _LONG
    findings = recording.findings + look(recording, workers=workers if long else 1)

    used = _for_motion(settings, findings)

    def work(series: AxisSeries) -> AxisReport | Finding:
        try:
            return _characterize_axis(series, used, recording.temperature, findings)
        except DataError as error:
            return _no_result(series, error, findings)

    def tell(done: int, following: AxisSeries | None) -> None:
        if progress:
            progress(done, len(recording.series), following.name if following else "")

    found = side_by_side(work, recording.series, workers=workers, done=tell)
    axes = [axis for axis in found if isinstance(axis, AxisReport)]
    failures = [failure for failure in found if isinstance(failure, Finding)]
    if not axes:
        reasons = _reasons(failures) or "the log has no samples"
        raise DataError(f"{recording.source.path}: no axis can be analysed: {reasons}")
    report = Report(
        source=replace(recording.source, read=recording.source.read or ReadRange.of(recording.series)),
        axes=tuple(axes),
        settings=settings.document(),
        version=__version__,
        findings=(*_of_no_result(findings, axes, failures), *failures),
    )
    return advised_report(report, recording)


def _for_motion(settings: Settings, findings: Sequence[Finding]) -> Settings:
    """Return the settings for the fits: a search for the best model of motion takes long and helps nobody."""
    return replace(settings, method="slope", model="auto") if _moved(findings) else settings


def _moved(findings: Sequence[Finding]) -> bool:
    """Return whether a screening found that the IMU was not at rest."""
    return any(finding.code in {"motion", "touch"} and finding.level == "error" for finding in findings)


def _no_result(series: AxisSeries, error: DataError, findings: Sequence[Finding]) -> Finding:
    """Return why an axis has no result, with the screening's advice about an axis without data."""
    advice = next((f.advice for f in findings if f.axis == series.name and f.code == "no-data"), "")
    return Finding("error", "no-result", f"{error}.", advice, axis=series.name)


def _of_no_result(
    findings: Sequence[Finding], axes: Sequence[AxisReport], failures: Sequence[Finding]
) -> Iterator[Finding]:
    """Yield the findings of no axis's result; a failure says what `no-data` says, and more."""
    fitted, failed = {axis.name for axis in axes}, {failure.axis for failure in failures}
    for finding in findings:
        if finding.axis not in fitted and (finding.code != "no-data" or finding.axis not in failed):
            yield finding


@takes('imucal.screen(imucal.read("log.mcap"))', recording=Recording)
def screen(recording: Recording, *, workers: int = 1) -> tuple[Finding, ...]:
    """Return what speaks against trusting a recording, worst first; empty for a good one.

    Codes: ``absurd-rate``, ``fast-rate``, ``no-data``, ``not-finite``, ``stuck``, ``saturated``,
    ``held-samples``, ``coarse-lsb``, ``swapped-sensors``, ``duplicate-axes``, ``unit-suspect``,
    ``no-gravity``, ``motion``, ``touch``, and of an IMU at rest ``step``, ``cycle``, ``warm-up``,
    ``temperature``, ``tone``, ``roll-off``. The last are what a fit by maximum likelihood
    takes out, and says of itself. What reading the log has said already is not said again. So many axes
    as `workers` are worked on at a time; the findings are the same for any number.
    """
    findings = screen_values(recording, workers=workers)
    if _moved(findings):
        return findings

    def look(series: AxisSeries) -> tuple[Finding, ...]:
        finite = series.finite()
        found = findings_or_why_not(
            lambda: not_noise(finite, _temperature_at(finite, recording.temperature)),
            what="The search for disturbances failed",
            code="not-checked",
            axis=series.name,
        )
        release(series.samples)
        return found

    found = side_by_side(look, recording.series, workers=workers)
    return worst_first(recording, [*findings, *chain.from_iterable(found)])


def _workers(recording: Recording, wanted: int | None) -> int:
    """Return how many axes to work on at a time: as wanted or as there are processors, and memory holds."""
    if wanted is not None and wanted < 1:
        raise ArgumentError(f"workers must be at least 1, got {wanted}")
    largest = max((series.n for series in recording.series), default=0)
    count, room = (threads(), min(memory_limit(), _ROOM)) if wanted is None else (wanted, memory_limit())
    return max(1, min(count, room // (_BESIDES + _BYTES * largest)))


def _reasons(failures: list[Finding]) -> str:
    """Return why axes could not be analysed; those with the same reason stand together."""
    axes: dict[str, list[str]] = {}
    for failure in failures:
        name = failure.axis or ""
        axes.setdefault(failure.text.removeprefix(f"{name}: ").removesuffix("."), []).append(name)
    return "; ".join(f"{', '.join(names)}: {reason}" for reason, names in axes.items())


def _characterize_axis(
    series: AxisSeries, settings: Settings, temperature: Temperature | None, screened: tuple[Finding, ...]
) -> AxisReport:
    finite = series.finite()
    if not finite.n:
        raise DataError(f"{series.name}: no finite samples among {series.n}")
    # The fit says so of a short one, for which it needs no time and no memory.
    if finite.n > _BLOCK and never_changes(finite.samples):
        raise no_noise(finite)
    at_samples = _temperature_at(finite, temperature)
    with shared_transform(finite.samples):
        curve = allan_curve(finite, taus=settings.taus, edf=settings.edf)
        density = spectrum(finite)
        # The fit takes the transform for its own.
        result = fit_axis(finite, settings, temperature=at_samples, curve=curve)
        opinions: tuple[Finding, ...] = ()
        if settings.second_opinion and settings.method == "mle" and result.model.terms:
            opinions = _opinions(finite, result, at_samples)
    findings = [f for f in screened if f.axis == series.name]
    if not _moved(screened):
        # Of motion the screening reports all that helps.
        found = (*_of_fit(result, finite, density), *opinions)
        findings += [replace(finding, axis=series.name) for finding in found]
    mean, std = _moments(finite.samples)
    overview = Overview.of(finite)
    # What lies in a temporary file need not stay in memory: nobody looks at this axis any more.
    release(series.samples)
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
    """Return the fit's findings, and what the length of the record and the curve leave open."""
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


def _opinions(series: AxisSeries, first: NoiseFit, temperature: FloatArray | None) -> tuple[Finding, ...]:
    """Return where a fit of the curve disagrees, and whether one half of the record predicts the other.

    That either can't be told costs no axis its result.
    """
    if any(finding.code == "spikes" for finding in first.findings):
        series = clean(series)[0]
    return findings_or_why_not(
        lambda: second_opinion(first, fit_of_curve(series, first, temperature)),
        what="The fit of the Allan curve failed",
        code="second-opinion",
        axis=series.name,
    ) + findings_or_why_not(
        lambda: self_check(series, first, temperature),
        what="The prediction of one half from the other failed",
        code="predicts-badly",
        axis=series.name,
    )


def _moments(samples: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation without a copy of the samples, which may lie in a mapped file."""
    mean = float(np.mean(samples))
    parts = (samples[start : start + _PART] - mean for start in range(0, samples.size, _PART))
    return mean, float(np.sqrt(sum(float(np.sum(part * part)) for part in parts) / samples.size))


def _temperature_at(series: AxisSeries, temperature: Temperature | None) -> FloatArray | None:
    """Return the temperature at each sample, by straight lines where it was measured at other times."""
    if temperature is None:
        return None
    known, clock = np.isfinite(temperature.samples), temperature.clock
    if np.count_nonzero(known) < _FEWEST_DEGREES:
        return None
    if clock is series.clock and known.all():
        return temperature.samples
    at, seconds = series.clock.grid() * series.tau0, clock.grid()[known] * clock.tau0
    if series.clock.start_ns is not None and clock.start_ns is not None:
        at += (series.clock.start_ns - clock.start_ns) / 1e9
    return np.asarray(np.interp(at, seconds, temperature.samples[known]))
