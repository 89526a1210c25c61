"""Evidence of the rows of gravity, units, axes and delay: gravity over time, and in turns."""

import numpy as np

from imucal.arrays import BoolArray, FloatArray
from imucal.calibration.poses import Triad
from imucal.health.evidence import Curve, Evidence, Limit, Span, merged, thinned
from imucal.health.stream import Stream
from imucal.health.turning import PROPER, Turning
from imucal.recording import AXES, Sensor
from imucal.units import G0

__all__ = ["first_attitude", "gravity_length_over_time", "orders_compared", "rate_over_time", "turned_angles"]

#: Ratio of two values that a linear scale can't show.
_FAR_APART = 20.0
#: The same of two angles, whose values must be compared.
_FEW_TIMES = 4.0
#: Time shown after the first rest, in s.
_AFTER_S = 3.0
#: Longest part of the first rest that is shown, in s.
_REST_SHOWN_S = 10.0
#: Number of orders that are shown besides the log's own.
_ORDERS_SHOWN = 5
#: Time of a step along the path of gravity, in s: noise of 2 mrad adds 2° to 20 of them.
_CHORD_S = 0.15
#: Least angle that is shown, in degrees.
_LEAST_DEG = 0.1


def gravity_length_over_time(stream: Stream, *, swapped: bool = False) -> Evidence | None:
    """Return the length of the specific force over time; if `swapped`, that of the gyroscope, too."""
    if stream.accelerometer is None:
        return None
    time, length = _length(stream.accelerometer)
    curves = [Curve(label="length of the accelerometer", x=time, y=length)]
    if swapped and stream.gyroscope is not None:
        time, other = _length(stream.gyroscope)
        curves.append(Curve(label="length of the gyroscope", x=time, y=other))
    usual = float(np.nanmedian(length))
    return Evidence(
        title="length of the specific force, compared with gravity",
        x_label="time (s)",
        y_label="length of f (m/s²)",
        curves=tuple(curves),
        limits=(Limit(label="9.81 m/s²", value=G0),),
        shaded=_quiet_spans(stream),
        shade_label="at rest" if len(stream.rests) else "quietest moments",
        log_y=bool(usual > _FAR_APART * G0),
    )


def rate_over_time(stream: Stream, *, fastest: float, label: str) -> Evidence | None:
    """Return the length of the rotation rate over time, and a limit in rad/s."""
    if stream.gyroscope is None:
        return None
    time, rate = _length(stream.gyroscope)
    return Evidence(
        title="length of the rotation rate",
        x_label="time (s)",
        y_label="rate (rad/s)",
        curves=(Curve(label="length of the gyroscope", x=time, y=rate),),
        limits=(Limit(label=label, value=fastest),),
        shaded=_quiet_spans(stream),
        shade_label="at rest" if len(stream.rests) else "quietest moments",
        log_y=bool(np.nanmax(rate) > _FAR_APART * fastest),
    )


def first_attitude(stream: Stream, *, length: float) -> Evidence | None:
    """Return the axes of the accelerometer in the first rest, and the length of gravity."""
    data = stream.accelerometer
    if data is None:
        return None
    spans = _quiet_spans(stream)
    start, end = spans[0] if spans else (0.0, _AFTER_S)
    end = min(end, start + _REST_SHOWN_S)
    first, stop = data.places(np.array([start - _AFTER_S, end + _AFTER_S]))
    time = data.offset_s + np.arange(first, stop) / data.rate_hz
    curves = []
    for k, axis in enumerate(AXES):
        x, y = thinned(time, data.samples[first:stop, k])
        curves.append(Curve(label=f"accel_{axis}", x=x, y=y))
    return Evidence(
        title="the accelerometer's axes at the first rest",
        x_label="time (s)",
        y_label="specific force (m/s²)",
        curves=tuple(curves),
        limits=(Limit(label="gravity, up", value=length), Limit(label="gravity, down", value=-length)),
        shaded=((start, end),),
        shade_label="first rest" if len(stream.rests) else "first quiet moment",
    )


def turned_angles(turning: Turning, *, order: int, shown: BoolArray) -> Evidence:
    """Return by how much gravity turns in each part, against the angle of the gyroscope.

    Both are lengths of the path of gravity's direction; that of the gyroscope follows from the rates as they
    are, in the `order` of axes that explains the turns. Steps are so long that noise does not lengthen them.
    """
    turns = turning.keeping(shown)
    sign = 1.0 if order < len(PROPER) else -1.0
    force = turns.forces @ PROPER[order % len(PROPER)]
    direction = force / np.linalg.norm(force, axis=2, keepdims=True)
    middle = (direction[:, 1:] + direction[:, :-1]) / 2
    rates = sign * (turns.rates[:, 1:] + turns.rates[:, :-1]) / 2
    corners = direction[:, :: max(1, round(_CHORD_S / turns.step_s))]
    chords = np.linalg.norm(np.diff(corners, axis=1), axis=2)
    of_gravity = 2 * np.arcsin(np.minimum(chords / 2, 1.0)).sum(axis=1)
    of_gyroscope = turns.step_s * np.linalg.norm(np.cross(rates, middle), axis=2).sum(axis=1)
    x, y = np.degrees(of_gyroscope), np.degrees(of_gravity)
    ends = np.array([min(x.min(), y.min()), max(x.max(), y.max())]).clip(_LEAST_DEG)
    far = bool(np.median(x) > _FEW_TIMES * np.median(y) or np.median(y) > _FEW_TIMES * np.median(x))
    return Evidence(
        title="angle by which gravity turns in parts of the log, against the gyroscope",
        x_label="angle of the gyroscope, read as rad/s (deg)",
        y_label="angle of gravity (deg)",
        curves=(
            Curve(label="equal angles", x=ends, y=ends, look="line"),
            Curve(label="a turn", x=x, y=y, look="dots"),
        ),
        log_x=far,
        log_y=far,
    )


def orders_compared(shares: FloatArray, names: tuple[str, ...]) -> Evidence:
    """Return the unexplained share of the log's own order of axes, the first one, and of the best ones."""
    best = [int(k) for k in np.argsort(shares[1:])[:_ORDERS_SHOWN] + 1]
    chosen = [0, *best]
    labels = [f"{names[k]} (this log)" if k == 0 else names[k] for k in chosen]
    return Evidence(
        title="unexplained share of gravity's turns; x=-y: the gyroscope's x is the accelerometer's -y",
        x_label="unexplained share (%)",
        y_label="",
        curves=(
            Curve(label="", x=100 * shares[chosen], y=np.arange(len(chosen), dtype=np.float64), look="bars"),
        ),
        names=tuple(labels),
    )


def _length(data: Triad) -> tuple[FloatArray, FloatArray]:
    time = data.offset_s + np.arange(len(data.samples)) / data.rate_hz
    return thinned(time, np.linalg.norm(data.samples, axis=1))


def _quiet_spans(stream: Stream) -> tuple[Span, ...]:
    if len(stream.rests):
        return merged([(float(start), float(end)) for start, end in stream.rests])
    axes = stream.quiet(Sensor.ACCELEROMETER)
    if not axes:
        return ()
    windows = axes[0].windows
    return merged(list(zip(windows.time_s.tolist(), windows.end_s.tolist(), strict=True)))
