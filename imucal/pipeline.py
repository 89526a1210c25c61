"""characterize: Recording -> Report, axis by axis. No input, no output."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TypeAlias

import numpy as np

from imucal._version import __version__
from imucal.allan import allan_curve, spectrum
from imucal.allan.dct import shared_transform
from imucal.arrays import FloatArray, never_changes, release
from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting import FitSettings, NoiseFit, fit_axis
from imucal.fitting.ambiguity import ambiguity_findings
from imucal.fitting.cross_checks import second_opinion
from imucal.fitting.curve_opinion import fit_of_curve
from imucal.fitting.robust import clean
from imucal.fitting.spectral.blocks import no_noise
from imucal.planning import resolution_findings
from imucal.processes import findings_or_why_not, side_by_side
from imucal.recording import AxisSeries, ReadRange, Recording, Temperature
from imucal.report.result import AxisReport, Overview, Report
from imucal.resources import memory_limit, threads
from imucal.screening import screen

#: Samples looked at at once.
_BLOCK = 1 << 20
#: Bytes that the analysis of an axis takes for each of its samples and besides, and those that all axes may
#: take that are worked on at a time unless a number is wanted.
_BYTES, _BESIDES, _ROOM = 24, 25_000_000, 300_000_000
#: What every axis needs of libraries that are loaded when they are used.
_LIBRARIES = ("scipy.fft", "scipy.special")
#: A remark of the screening, and the finding of the fit that says the same with more.
_SAID_BETTER = (("roll-off", "output-filter"), ("tone", "line"))
#: The settings in the order of report.json; `reading` comes last.
_DOCUMENTED = (
    *("model", "method", "level", "criterion", "weights", "taus", "edf"),
    *("max_gm", "clean", "verify", "second_opinion", "segments", "bins"),
)

#: Samples worked on at a time, which stay in the cache.
_PART = 1 << 15

#: Called with the number of axes done, of all axes, and the name of the next one.
Progress: TypeAlias = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
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


def characterize(
    recording: Recording,
    settings: Settings | None = None,
    *,
    progress: Progress | None = None,
    workers: int | None = None,
) -> Report:
    """Screen a recording and fit a noise model to every axis.

    An axis that can't be analysed is left out and named in a finding.

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
    if workers > 1:
        # Once, by the process that the others are forked from.
        for name in _LIBRARIES:
            import_module(name)
    findings = recording.findings + screen(recording, workers=workers)

    def work(series: AxisSeries) -> AxisReport | Finding:
        try:
            return _characterize_axis(series, settings, recording.temperature, findings)
        except DataError as error:
            return _no_result(series, error, findings)

    def tell(done: int, following: AxisSeries | None) -> None:
        if progress:
            progress(done, len(recording.series), following.name if following else "")

    found = side_by_side(work, recording.series, workers=workers, done=tell)
    axes = [axis for axis in found if isinstance(axis, AxisReport)]
    failures = [failure for failure in found if isinstance(failure, Finding)]
    if not axes:
        reasons = _reasons(failures) or "the log holds no samples"
        msg = f"{recording.source.path}: no axis can be analysed: {reasons}"
        raise DataError(msg)
    return Report(
        source=replace(recording.source, read=recording.source.read or ReadRange.of(recording.series)),
        axes=tuple(axes),
        settings=settings.document(),
        version=__version__,
        findings=_of_no_result(findings, axes, failures),
    )


def _workers(recording: Recording, wanted: int | None) -> int:
    """Return how many axes to work on at a time: as many as wanted, or as the machine has processors for.

    So many as the memory holds; those that nobody asked for keep to little.
    """
    if wanted is not None and wanted < 1:
        msg = f"workers must be at least 1, got {wanted}"
        raise ValueError(msg)
    largest = max((series.n for series in recording.series), default=0)
    count, room = (threads(), min(memory_limit(), _ROOM)) if wanted is None else (wanted, memory_limit())
    return max(1, min(count, room // (_BESIDES + _BYTES * largest)))


def _no_result(series: AxisSeries, error: DataError, screened: tuple[Finding, ...]) -> Finding:
    """Return why an axis has no result, with the screening's advice about an axis without data."""
    advice = next((f.advice for f in screened if f.axis == series.name and f.code == "no-data"), "")
    return Finding(level="error", code="no-result", axis=series.name, text=f"{error}.", advice=advice)


def _of_no_result(
    screened: tuple[Finding, ...], axes: list[AxisReport], failures: list[Finding]
) -> tuple[Finding, ...]:
    """Return the findings that are of no axis's result; a failure says what `no-data` says, and more."""
    fitted = {axis.name for axis in axes}
    failed = {failure.axis for failure in failures}
    others = (f for f in screened if f.axis not in fitted and (f.code != "no-data" or f.axis not in failed))
    return (*others, *failures)


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
        msg = f"{series.name}: no finite samples among {series.n}"
        raise DataError(msg)
    # The fit says so of a short one, for which it needs no time and no memory.
    if finite.n > _BLOCK and never_changes(finite.samples):
        raise no_noise(finite)
    at_samples = _same_clock(series, finite, temperature)
    with shared_transform(finite.samples):
        curve = allan_curve(finite, taus=settings.taus, edf=settings.edf)
        density = spectrum(finite)
        # The fit takes the transform for its own.
        result = fit_axis(finite, settings, temperature=at_samples, curve=curve)
        opinion: tuple[Finding, ...] = ()
        if settings.second_opinion and settings.method == "mle":
            opinion = _second_opinion(finite, result, at_samples)
    found = result.findings + findings_or_why_not(
        lambda: resolution_findings(result, finite.duration_s),
        what="How long a record would do is not known",
        code="record-length",
    )
    found += findings_or_why_not(
        lambda: ambiguity_findings(result, density, series.name),
        what="What the curve can't tell is not known",
        code="spectral-ambiguity",
    )
    found += opinion
    # Of steps the fit says more: it has taken them out, or knows that they go to and fro.
    taken_out = {"step"} if {f.code for f in found} & {"step", "telegraph"} else set()
    findings = [f for f in screened if f.axis == series.name and f.code not in taken_out]
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
        findings=_without_repeats(findings),
    )


def _second_opinion(
    series: AxisSeries, first: NoiseFit, temperature: FloatArray | None
) -> tuple[Finding, ...]:
    """Return where a fit of the curve disagrees; that it can't be made costs no axis its result."""
    if not first.model.terms:
        return ()

    def judge() -> tuple[Finding, ...]:
        cleaned = any(finding.code == "spikes" for finding in first.findings)
        samples = clean(series)[0] if cleaned else series
        return second_opinion(first, fit_of_curve(samples, first, temperature))

    return findings_or_why_not(
        judge, what="The Allan curve gives no second opinion", code="second-opinion", axis=series.name
    )


def _moments(samples: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation without a copy of the samples, which may lie in a mapped file."""
    mean = float(np.mean(samples))
    parts = (samples[start : start + _PART] - mean for start in range(0, samples.size, _PART))
    return mean, float(np.sqrt(sum(float(np.sum(part * part)) for part in parts) / samples.size))


def _same_clock(series: AxisSeries, finite: AxisSeries, temperature: Temperature | None) -> FloatArray | None:
    """Return the temperature at each finite sample, where it was measured with them."""
    if temperature is None or temperature.samples.shape != series.samples.shape:
        return None
    at_samples = temperature.samples[series.usable]
    return at_samples if at_samples.shape == finite.samples.shape and np.isfinite(at_samples).all() else None


def _without_repeats(findings: list[Finding]) -> tuple[Finding, ...]:
    """Leave out what the fit says better than the screening did: its filter, and the lines it left out."""
    codes = {finding.code for finding in findings}
    said_better = {screened for screened, fitted in _SAID_BETTER if fitted in codes}
    # A warning says more than the remark of the fit: that the tone bends the curve.
    kept = (finding for finding in findings if finding.code not in said_better or finding.level != "info")
    return tuple(dict.fromkeys(kept))
