"""The pictures of a report, drawn side by side where processes may be forked: each is worth half a second."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING

from imucal.findings import Finding
from imucal.parallel import side_by_side
from imucal.recording import Sensor
from imucal.report import figure
from imucal.report.result import AxisReport, Report
from imucal.resources import threads
from imucal.side_work import try_side_work

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Loaded once, by the process that the others are forked from.
_LIBRARIES = ("matplotlib.figure", "matplotlib.backends.backend_agg")


@dataclass(slots=True)
class Drawings:
    """What was drawn, and what could not be.

    Attributes
    ----------
    files
        Contents by the name of the file.
    small
        The page's pictures by the name of the axis.
    failures
        Why a file is missing, in the order of the files.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    small: dict[str, bytes] = field(default_factory=dict)
    failures: list[Finding] = field(default_factory=list)


def picture_names(report: Report, formats: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the files that are drawn of a report."""
    return tuple(f"{_stem(item)}.{form}" for item in _items(report) for form in formats)


def draw(report: Report, formats: Sequence[str], *, small: bool, workers: int | None = None) -> Drawings:
    """Draw the pictures of a report.

    Parameters
    ----------
    formats
        Of the files: ``png``, ``svg``, ``pdf``.
    small
        Whether to draw those of the page too.
    workers
        Most at a time; by default as many as the machine has processors.
    """
    items = _items(report) if formats else tuple(report.axes) if small else ()
    count = threads() if workers is None else workers
    if count > 1 and items:
        for name in _LIBRARIES:
            import_module(name)
    drawn = Drawings()
    work = partial(_drawn, report, formats=tuple(formats), small=small)
    for one in side_by_side(work, items, workers=count):
        drawn.files |= one.files
        drawn.small |= one.small
        drawn.failures += one.failures
    return drawn


def _items(report: Report) -> tuple[AxisReport | Sensor, ...]:
    """Return what has a picture: each axis, and each sensor."""
    sensors = (sensor for sensor in Sensor if any(axis.sensor is sensor for axis in report.axes))
    return (*report.axes, *sensors)


def _stem(item: AxisReport | Sensor) -> str:
    return item.short if isinstance(item, Sensor) else item.name


def _drawn(report: Report, item: AxisReport | Sensor, *, formats: tuple[str, ...], small: bool) -> Drawings:
    """Draw one picture once, and make all of its files."""

    @cache
    def made() -> "Figure":
        if isinstance(item, Sensor):
            return figure.sensor_figure(report, item)
        return figure.axis_figure(report, item)

    result = Drawings()
    for form in formats:
        name = f"{_stem(item)}.{form}"
        content, failed = try_side_work(
            lambda form=form: figure.render(made(), form, version=report.version),  # type: ignore[misc]
            None,
            what=f"{name} was left out",
            code="not-drawn",
        )
        if content is not None:
            result.files[name] = content
        result.failures += failed
    if small and isinstance(item, AxisReport):
        # The page draws what is missing itself, and says why it can't.
        content, _ = try_side_work(lambda: figure.render_small(made()), None, what="", code="not-drawn")
        if content is not None:
            result.small[item.name] = content
    return result
