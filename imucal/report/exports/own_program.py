"""Files for a program of your own: a state space for a Kalman filter, and every term with its interval.

In the state space each axis is white noise and a bank of first-order states: ``x[t+1] = phi x[t] + q w[t]``,
w standard normal; the sample is the sum of the states and ``sigma`` times white noise. Flicker has no finite
state space; a bank of Gauss-Markov processes with log-spaced T and variance ``B^2 ln(r) / pi`` each (r the
ratio of neighbours) has its psd to 0.7 % at 1.5 states a decade, inside the bank. The bank reaches from where
flicker begins to stand out of the white noise to the length of the record.

The other file has continuous coefficients in SI, and the discrete numbers that follow from them at the
sensor's own rate. A term that the data don't show has an ``upper_bound`` in place of a ``value``.
"""

import math
from collections.abc import Iterator

from imucal.fitting.noise_fit import Estimate
from imucal.noise.terms import TERMS, GaussMarkov
from imucal.recording import Sensor
from imucal.report.exports.config_numbers import Number, Numbers
from imucal.report.exports.target import Body, Target, quoted, real
from imucal.report.result import AxisReport

#: States a decade of correlation time.
_PER_DECADE = 1.5
#: How far the bank reaches below the time at which flicker and white noise are equal.
_MARGIN = 10.0


def flicker_bank(B: float, shortest_s: float, longest_s: float) -> tuple[GaussMarkov, ...]:
    """Return Gauss-Markov terms whose sum is flicker B for times between `shortest_s` and `longest_s`."""
    steps = max(1, math.ceil(_PER_DECADE * math.log10(longest_s / shortest_s)))
    ratio = (longest_s / shortest_s) ** (1 / steps)
    sigma = B * math.sqrt(math.log(ratio) / math.pi)
    return tuple(GaussMarkov(sigma=sigma, T=shortest_s * ratio**i) for i in range(steps + 1))


def _state_space(numbers: Numbers) -> Body:
    axes = [axis for sensor in numbers.sensors for axis in numbers.axes(sensor)]
    used = [numbers.of(axis, symbol) for axis in axes for symbol in ("N", "K")]
    lines = ["axes:"]
    for axis in axes:
        lines += _axis_states(numbers, axis)
    return used, lines


def _axis_states(numbers: Numbers, axis: AxisReport) -> Iterator[str]:
    rate_hz = float(f"{axis.rate_hz:.9g}")
    white, walk = numbers.of(axis, "N"), numbers.of(axis, "K")
    yield f"  {axis.name}:"
    yield f"    unit: {axis.unit}"
    yield f"    rate_hz: {real(rate_hz)}"
    yield f"    white: {real(white.value * math.sqrt(rate_hz))}  # {white.note}"
    yield "    states:"
    if axis.fit["K"].value is None or axis.fit["K"].drawn:
        yield f"      - {{term: K, phi: 1.0, q: {real(walk.value / math.sqrt(rate_hz))}}}  # {walk.note}"
    else:
        yield f"    # K: what GM begins with, so that it is no state of its own; {walk.note}"
    for estimate in axis.fit.estimates:
        if estimate.symbol == GaussMarkov.symbol and estimate.value and estimate.correlation_time is not None:
            sigma = estimate.value * numbers.choices.factor(GaussMarkov.symbol)
            term = GaussMarkov(sigma=sigma, T=estimate.correlation_time.value)
            yield _state(estimate.key, term, rate_hz)
    if axis.fit["B"].value is None:
        yield "    # B: not identified, left out"
        return
    for term in _bank(numbers.of(axis, "B"), white, axis.duration_s, rate_hz):
        yield _state("B", term, rate_hz)


def _bank(flicker: Number, white: Number, duration_s: float, rate_hz: float) -> tuple[GaussMarkov, ...]:
    floor = 2 * math.log(2) / math.pi * flicker.value**2
    equal_s = white.value**2 / floor
    longest = max(duration_s, 10 / rate_hz)
    shortest = min(max(1 / rate_hz, equal_s / _MARGIN), longest / 2)
    return flicker_bank(flicker.value, shortest, longest)


def _state(name: str, term: GaussMarkov, rate_hz: float) -> str:
    values = {
        "phi": term.phi(1 / rate_hz),
        "q": term.q(1 / rate_hz),
        "sigma": term.sigma,
        "T": term.T,
    }
    body = ", ".join(f"{key}: {real(value)}" for key, value in values.items())
    return f"      - {{term: {name}, {body}}}"


def _every_term(numbers: Numbers) -> Body:
    used = [
        numbers.of(axis, symbol)
        for sensor in numbers.sensors
        for axis in numbers.axes(sensor)
        for symbol in ("N", "B", "K")
    ]
    lines = ["imu:"]
    for sensor in numbers.sensors:
        lines += [
            f"  {sensor}:",
            f"    rate_hz: {real(numbers.rate_hz(sensor))}",
            f"    unit: {quoted(sensor.unit)}",
            f"    filter: {{{_pair(numbers, sensor)}}}",
        ]
        for axis in numbers.axes(sensor):
            lines += _axis_terms(numbers, axis)
    return used, lines


def _pair(numbers: Numbers, sensor: Sensor) -> str:
    """Return what covers the spectrum of a sensor's axes, inflated."""
    pair, factor = numbers.pair(numbers.chosen(sensor)), numbers.choices.factor
    members = {
        "white": pair.white * factor("N"),
        "walk": pair.walk * factor("K"),
        "horizon_s": pair.horizon_s,
        "step_s": pair.step_s,
    }
    return ", ".join(f"{key}: {real(value)}" for key, value in members.items())


def _axis_terms(numbers: Numbers, axis: AxisReport) -> Iterator[str]:
    rate_hz = numbers.rate_hz(axis.sensor)
    white, walk = numbers.of(axis, "N").value, numbers.of(axis, "K").value
    yield f"    {axis.axis}:"
    yield f"      white_noise_per_sample: {real(white * math.sqrt(rate_hz))}  # N * sqrt(f)"
    yield f"      bias_step_per_sample: {real(walk / math.sqrt(rate_hz))}  # K / sqrt(f)"
    for estimate in axis.fit.estimates:
        yield f"      {estimate.key}: {{{', '.join(_members(numbers, axis, estimate))}}}"


def _members(numbers: Numbers, axis: AxisReport, estimate: Estimate) -> Iterator[str]:
    factor = numbers.choices.factor(estimate.symbol)
    if estimate.value is None:
        yield f"upper_bound: {real(estimate.high * factor)}"
    else:
        yield f"value: {real(estimate.value * factor)}"
        yield f"low: {real(estimate.low * factor)}"
        yield f"high: {real(estimate.high * factor)}"
        if estimate.drawn is None:
            yield "part_of: GM"
    if estimate.correlation_time is not None:
        yield f"correlation_time_s: {real(estimate.correlation_time.value)}"
    if math.isfinite(estimate.horizon_s):
        yield f"holds_to_s: {real(estimate.horizon_s)}"
    if estimate.alternatives:
        yield f"or: [{', '.join(estimate.alternatives)}]"
    yield f"unit: {quoted(TERMS[estimate.symbol].unit(axis.sensor))}"


TARGETS = (
    Target(
        name="gm",
        title="state space: phi and q for a Kalman filter",
        file_name="state_space.yaml",
        heading="state-space noise model",
        source="no program: the equations are in the file",
        kind="discrete: x[t+1] = phi x[t] + q w[t], w standard normal; right for the rate of each axis only",
        formulas=(
            "white = N * sqrt(f); random walk: phi = 1, q = K / sqrt(f)",
            "Gauss-Markov: phi = exp(-1/(f T)), q = sigma * sqrt(1 - phi^2)",
            "flicker B: Gauss-Markov states with log-spaced T, sigma = B * sqrt(ln(ratio of T) / pi)",
        ),
        body=_state_space,
        carries="N B GM K",
        per_axis=True,
        own_rates=True,
        aliases=("gaussmarkov", "statespace"),
    ),
    Target(
        name="yaml",
        title="every term with its interval, for a program of your own",
        file_name="imu_noise.yaml",
        heading="IMU noise model",
        source="no program: every key is in the file",
        kind="coefficients are continuous, SI; *_per_sample are discrete, right for rate_hz only",
        formulas=(
            "white_noise_per_sample = N * sqrt(f), bias_step_per_sample = K / sqrt(f)",
            "filter: the least white noise and walk (densities) that cover the spectrum of the sensor's axes",
        ),
        body=_every_term,
        carries="Q N B GM K R",
        per_axis=True,
        own_rates=True,
        notes=("limits are those of the intervals; a term with upper_bound was not identified",),
        aliases=("generic", "genericyaml"),
    ),
)
