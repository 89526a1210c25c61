"""Are several logs parts of one recording, of which each goes on where the one before ends."""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from imucal.arrays import FloatArray
from imucal.readers.tables.scales import converter_step, sample_rows
from imucal.recording import Recording, Sensor

#: A part goes on within this time of the end of the one before, in s.
_PAUSE = 10.0
#: Stamps of two parts may run over each other by so many samples, or by this time in s.
_SAMPLES_OVER, _TIME_OVER = 10, 0.1
#: Usual magnitudes of the accelerations, and steps, of one sensor agree within these factors.
_SAME_GRAVITY, _SAME_STEP = 1.2, 1.02
#: Less than this, in m/s^2, is no gravity.
_NO_GRAVITY = 1.0
#: Factors between the units of rates: deg/s and rad/s, thousandths; noise agrees with one within this.
_UNIT_FACTORS, _LIKE_UNIT = (np.degrees(1.0), 1e3, 1e3 * np.degrees(1.0)), 1.25

#: Endings of a name, and the number that rotation puts behind them.
_ENDINGS = re.compile(
    r"(?:\.(?:csv|tsv|txt|log|dat|mcap|db3|bag|active|ulg|parquet|npz|npy|mat|gz|bz2|xz|lz4|zst|zstd))+"
    r"(?P<number>(?:\.\d+)?)$"
)
#: Names that number devices: unit1, imu2, sensor3; a recording called imu has parts imu_0 and imu_1.
_DEVICE = re.compile(r"(?<![a-z])(?:(?:unit|device|dev|board|serial|sn)[\W_]*|imu|sensor|gyro)\d+$")

#: Decisions that parts of one recording have in common, and their names in a message.
_COMMON = (("frame", "frames"), ("layout", "layouts"), ("gyroscope unit", "gyroscope units"),
           ("accelerometer unit", "accelerometer units"))  # fmt: skip


def span_ns(recording: Recording) -> tuple[int, int] | None:
    """Return when a recording's first sample was taken and its last one ends, in ns; None without stamps."""
    clocks = [series.clock for series in recording.series]
    starts = [clock.start_ns for clock in clocks if clock.start_ns is not None]
    ends = [clock.start_ns + round(clock.duration_s * 1e9) for clock in clocks if clock.start_ns is not None]
    return (min(starts), max(ends)) if starts else None


def why_not_one(paths: Sequence[Path], parts: Sequence[Recording]) -> str:
    """Return why recordings, in the order of their times, are not parts of one; empty where they are.

    They are where their names differ in numbers alone, topic, frame and scale are the same, and each goes
    on where the one before ends.
    """
    names = [path.name for path in paths]
    return (
        overlap(names, parts)
        or _differences(parts)
        or _scales(names, parts)
        or _names(paths)
        or _pauses(names, parts)
    )


def overlap(names: Sequence[str], parts: Sequence[Recording]) -> str:
    """Return which recordings, in the order of their times, overlap; empty where none do."""
    for (i, first), (j, second) in pairwise(enumerate(parts)):
        before, after = span_ns(first), span_ns(second)
        if before is None or after is None:
            continue
        over = (min(before[1], after[1]) - after[0]) / 1e9
        tau0 = max(series.tau0 for series in (*first.series, *second.series))
        if over > max(_SAMPLES_OVER * tau0, _TIME_OVER):
            return f"{names[i]} and {names[j]} overlap in time by {over:.4g} s"
    return ""


def _differences(parts: Sequence[Recording]) -> str:
    """Return in what recordings differ: topics, columns, and what was decided of them."""
    topics = [", ".join(part.source.topics) for part in parts]
    if len(set(topics)) > 1:
        what = "topics" if parts[0].source.message_types else "columns"
        return f"their {what} differ ({' and '.join(dict.fromkeys(topics))})"
    for question, what in _COMMON:
        answers = [_answer(part, question) for part in parts]
        if len(set(answers)) > 1:
            return f"their {what} differ ({' and '.join(dict.fromkeys(map(str, answers)))})"
    return ""


def _answer(part: Recording, question: str) -> str:
    """Return what was decided; of a unit without the reason, but a scale with it."""
    answer = dict(part.source.decisions).get(question, "none")
    return answer if answer.startswith("count") else answer.partition(",")[0]


def _scales(names: Sequence[str], parts: Sequence[Recording]) -> str:
    """Return how the scales of two recordings differ, as their samples show it."""
    for i, part in enumerate(parts[1:], start=1):
        for sensor in Sensor:
            first, other = _rows(parts[0], sensor), _rows(part, sensor)
            found = _scale_differs(sensor, first, other) if first.size and other.size else ""
            if found:
                return f"the {sensor} of {names[0]} and that of {names[i]} differ in scale: {found}"
    return ""


def _rows(part: Recording, sensor: Sensor) -> FloatArray:
    axes = [series.samples for series in part.series if series.sensor is sensor]
    return sample_rows(axes) if axes else np.empty((0, 3))


def _scale_differs(sensor: Sensor, first: FloatArray, other: FloatArray) -> str:
    steps = converter_step(first), converter_step(other)
    if steps[0] and steps[1] and _apart(steps[0], steps[1]) > _SAME_STEP:
        return f"steps of {steps[0]:.4g} and {steps[1]:.4g} {sensor.unit}"
    if first.shape[1] != other.shape[1]:
        return ""
    return (_gravity_differs if sensor is Sensor.ACCELEROMETER else _noise_differs)(first, other)


def _gravity_differs(first: FloatArray, other: FloatArray) -> str:
    """Return how the usual magnitudes of three axes differ; turning the sensor leaves them alone."""
    one, two = (float(np.median(np.sqrt((rows**2).sum(axis=1)))) for rows in (first, other))
    if first.shape[1] < 3 or max(one, two) < _NO_GRAVITY or _apart(one, two) < _SAME_GRAVITY:
        return ""
    return f"a usual magnitude of {one:.4g} and {two:.4g} {Sensor.ACCELEROMETER.unit}"


def _noise_differs(first: FloatArray, other: FloatArray) -> str:
    """Return that the noise of all axes differs by the factor of two units; motion does not so on each."""
    if min(first.shape[0], other.shape[0]) < 2:
        return ""
    noises = [np.median(np.abs(np.diff(rows, axis=0)), axis=0) for rows in (first, other)]
    ratios = [_apart(float(one), float(two)) for one, two in zip(*noises, strict=True)]
    for factor in _UNIT_FACTORS:
        if all(_apart(ratio, factor) < _LIKE_UNIT for ratio in ratios):
            return f"the noise of one is {ratios[0]:.3g} times that of the other, as in another unit"
    return ""


def _apart(a: float, b: float) -> float:
    """Return by which factor two numbers differ; infinite where one is zero."""
    return max(a, b) / min(a, b) if min(a, b) > 0 else float("inf")


def _names(paths: Sequence[Path]) -> str:
    """Return that names are no series of parts: they differ in more than numbers, or number devices."""
    names = [path.name.lower() for path in paths]
    if len(set(map(series_of, names))) > 1:
        return "their names are no series: they differ in more than a number"
    if all(_DEVICE.search(_ENDINGS.sub("", name)) for name in names):
        return "their names number devices, not parts"
    return ""


def series_of(name: str) -> str:
    """Return what is left of a name without its numbers and the endings of formats."""
    return re.sub(r"[\W_]*\d+", "", _ENDINGS.sub(r"\g<number>", name))


def _pauses(names: Sequence[str], parts: Sequence[Recording]) -> str:
    """Return between which recordings there is a pause, or none that is known."""
    for (i, first), (j, second) in pairwise(enumerate(parts)):
        before, after = span_ns(first), span_ns(second)
        if before is None or after is None:
            return f"{names[i if before is None else j]} has no stamps that say when it was recorded"
        pause = (after[0] - before[1]) / 1e9
        if pause > _PAUSE:
            return f"{names[j]} starts {pause:.4g} s after the end of {names[i]}"
    return ""
