"""Tests of the decomposition: agreement with dense conditioning, invariances, and coverage of the errors."""

import re
from collections.abc import Iterator
from unittest import mock

import numpy as np
import numpy.testing as npt
import pytest

from imucal import NoiseModel, decompose, fit
from imucal.arrays import BoolArray, FloatArray
from imucal.errors import DataError
from imucal.fitting import wiener
from imucal.fitting.decomposition import Decomposition
from imucal.fitting.wiener import Component, smooth
from imucal.recording import AxisSeries
from tests.fitting.state_space import StateSpace
from tests.raising import raises

N = 300
#: Models whose terms are exactly, and approximately, independent at each ordinate.
EXACT = [
    "N=1",
    "N=1 + R=0.1",
    "N=1 + K=0.1",
    "N=1 + K=1e-9",
    "Q=1 + N=0.5 + K=0.05 + R=0.01",
    "Q=1 + K=0.01",
]
NEARLY = [
    "N=1 + B=0.5",
    "N=1 + GM(sigma=0.5, T=20)",
    "N=1 + B=0.5 + K=0.05 + GM(sigma=0.5, T=20)",
    "N=1 + GM(sigma=0.5, T=20) + GM(sigma=1, T=200) + R=0.01",
    "Q=0.3 + N=0.5 + B=0.5",
]
KINDS = ["none", "scattered", "gap", "one, then nothing"]


def dense(
    states: StateSpace, samples: FloatArray, seen: BoolArray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return each part's conditional mean and standard error from the n × n covariance; O(n³).

    Constants (a walk's start, level, slope) are columns of generalised least squares.
    """
    n, t = samples.size, np.arange(samples.size, dtype=np.float64)
    lag, least = np.abs(np.subtract.outer(t, t)), np.minimum.outer(t, t)
    total = np.eye(n) * states.white
    own = np.zeros((states.size, n, n))
    columns: list[tuple[str, FloatArray]] = [
        (name, np.ones(n) if name == "level" else t) for name in states.flat
    ]
    for i in range(states.size):
        if states.quantized and i == 0:
            total += states.drive[0] * (2 * np.eye(n) - (lag == 1))
            continue
        walk = np.isinf(states.start[i])
        own[i] = states.drive[i] * least if walk else states.start[i] * states.decay[i] ** lag
        total += own[i]
        columns += [("K", np.ones(n))] if walk else []
    inverse = np.linalg.inv(total[np.ix_(seen, seen)])
    X = np.array([column for _, column in columns]).T
    spread = np.linalg.inv(X[seen].T @ inverse @ X[seen])
    beta = spread @ X[seen].T @ inverse @ samples[seen]
    rest = inverse @ (samples[seen] - X[seen] @ beta)
    every = {**states.groups, **{name: np.zeros(states.size, dtype=bool) for name in states.flat}}
    every["bias"] = states.everything
    found = {}
    for key, group in every.items():
        cross = own[group].sum(axis=0) + np.zeros((n, n))
        used = X * [key in (name, "bias") for name, _ in columns]
        error = used - cross[:, seen] @ inverse @ X[seen]
        variance = np.diag(cross) - np.sum((cross[:, seen] @ inverse) * cross[:, seen], axis=1)
        variance = variance + np.sum((error @ spread) * error, axis=1)
        found[key] = used @ beta + cross[:, seen] @ rest, np.sqrt(np.maximum(variance, 0.0))
    return found


def _missing(kind: str, rng: np.random.Generator) -> BoolArray:
    """Return the mask of the N samples that are present."""
    seen = np.ones(N, dtype=bool)
    if kind == "scattered":
        seen = rng.random(N) > 0.2
        seen[[0, -1]] = True
    elif kind == "gap":
        seen[100:180] = False
    elif kind == "one, then nothing":
        seen[1:40] = False
    return seen


def _both(text: str, kind: str) -> Iterator[tuple[str, Component, FloatArray, FloatArray]]:
    """Yield key, component, and the mean and standard error from dense conditioning."""
    rng = np.random.default_rng(41)
    model = NoiseModel.parse(text)
    samples, seen = model.simulate(N, rate_hz=1.0, rng=rng), _missing(kind, rng)
    found = {part.key: part for part in smooth(model, samples, seen, 1.0)}
    expected = dense(StateSpace.of(model, rate_hz=1.0, n=N), samples, seen)
    assert set(found) == set(expected)
    for key, (mean, error) in expected.items():
        yield key, found[key], mean, error


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("text", EXACT)
def test_decomposition_agrees_with_dense_conditioning(text: str, kind: str) -> None:
    """Means and standard errors of every component agree, wherever samples are missing."""
    for _, part, mean, error in _both(text, kind):
        npt.assert_allclose(part.value, mean, atol=1e-8)
        npt.assert_allclose(part.error, error, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("text", NEARLY)
def test_flicker_and_gauss_markov_nearly_agree_with_dense_conditioning(text: str, kind: str) -> None:
    """The difference is a fraction of the standard error and largest at the ends of the record."""
    for key, part, mean, error in _both(text, kind):
        inside = error > 0  # the ramp starts at 0
        away, ratio = (part.value - mean)[inside] / error[inside], part.error[inside] / error[inside]
        # Parts differ more than their sum: in a record of 1.5 T, a level resembles Gauss-Markov noise.
        rms, least, most = (0.07, 0.97, 1.25) if key == "bias" else (0.5, 0.92, 1.35)
        found = float(np.sqrt(np.mean(away**2)))
        assert found < rms, f"{key}: {found}"
        assert np.abs(away).max() < 0.6, f"{key}: {np.abs(away).max()}"
        assert least < ratio.min() <= ratio.max() < most, f"{key}: {ratio.min()} to {ratio.max()}"


@pytest.mark.parametrize("kind", KINDS[1:])
@pytest.mark.parametrize("text", ["N=1 + K=0.1", "Q=1 + N=0.5 + K=0.05 + R=0.01", "Q=1 + K=0.01"])
def test_errors_with_many_missing_samples_are_sampled(
    text: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Conjugate gradients give the mean; the scatter of 30 draws is 13 % of the standard error."""
    monkeypatch.setattr(wiener, "_MIN_DRAWS", 30)
    monkeypatch.setattr(wiener, "_MAX_DRAWS", 30)
    for _, part, mean, error in _both(text, kind):
        assert np.abs(part.value - mean).max() < 2e-3 * error.max()
        npt.assert_allclose(part.error, error, rtol=0.45, atol=1e-6)


def _decomposed(text: str, n: int, seed: int, *, rate_hz: float = 10.0) -> Decomposition:
    model = NoiseModel.parse(text)
    samples = model.simulate(n, rate_hz=rate_hz, rng=np.random.default_rng(seed))
    return decompose(AxisSeries.from_samples(samples, rate_hz=rate_hz), model)


def test_the_bias_nearly_agrees_with_exact_flicker() -> None:
    """It differs by less than 0.15 standard errors from the bias with the exact flicker covariance."""
    from imucal.powerlaw import odd_harmonic

    model, rate = NoiseModel.parse("N=1 + B=0.5"), 10.0
    samples = model.simulate(N, rate_hz=rate, rng=np.random.default_rng(43))
    bias = decompose(AxisSeries.from_samples(samples, rate_hz=rate), model).bias
    lag = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    # The level is free, so flicker's variance can be any constant.
    cross = 0.25 * (40 - 2 / np.pi * odd_harmonic(lag.astype(np.float64)))
    inverse = np.linalg.inv(cross + rate * np.eye(N))
    ones = np.ones(N)
    level = float(ones @ inverse @ samples) / float(ones @ inverse @ ones)
    exact = level + cross @ inverse @ (samples - level)
    assert np.max(np.abs(bias.value - exact) / bias.error) < 0.15


def test_the_parts_add_up_to_the_samples() -> None:
    """Level, flicker, Gauss-Markov, ramp and residual agree to rounding; gaps have no residual."""
    model = NoiseModel.parse("N=1 + B=0.5 + GM(sigma=0.5, T=20) + R=1e-3")
    samples = 9.81 + model.simulate(3000, rate_hz=10.0, rng=np.random.default_rng(44))
    keep = np.ones(3000, dtype=bool)
    keep[1000:1500] = False
    series = AxisSeries.from_samples(samples, rate_hz=10.0).keeping(keep)
    parts = decompose(series, model)
    assert [part.key for part in parts.components] == ["level", "B", "GM", "R"]
    total = np.sum([part.value for part in parts.components], axis=0)
    npt.assert_allclose(total, parts.bias.value, atol=1e-9)
    npt.assert_allclose((total + parts.residual)[keep], samples[keep], atol=1e-9)
    assert np.isnan(parts.residual[~keep]).all()
    assert np.isfinite(total).all()
    npt.assert_allclose(parts.time_s, np.arange(3000) / 10)
    assert parts["level"].value[0] == pytest.approx(9.81, abs=3 * parts["level"].error[0])


def test_a_random_walk_is_a_bridge_in_a_gap() -> None:
    """It is a straight line between the ends of the gap, with the largest error in the middle."""
    model, keep = NoiseModel.parse("N=0.01 + K=1"), np.ones(1000, dtype=bool)
    keep[400:600] = False
    samples = model.simulate(1000, rate_hz=1.0, rng=np.random.default_rng(45))
    bias = decompose(AxisSeries.from_samples(samples, rate_hz=1.0).keeping(keep), model).bias
    inside = bias.value[400:600]
    npt.assert_allclose(np.diff(inside, 2), 0.0, atol=1e-9)
    # A bridge of 201 steps has the variance t (201 - t)/201.
    assert int(np.argmax(bias.error)) in range(498, 502)
    assert bias.error.max() == pytest.approx(np.sqrt(201 / 4), rel=1e-3)


def test_units_scale_all_parts_and_offsets_change_the_level_only() -> None:
    model, small = NoiseModel.parse("N=1 + B=0.5"), NoiseModel.parse("N=1e-7 + B=5e-8")
    samples = model.simulate(2000, rate_hz=10.0, rng=np.random.default_rng(46))
    base = decompose(AxisSeries.from_samples(samples, rate_hz=10.0), model)
    scaled = decompose(AxisSeries.from_samples(1e-7 * (samples + 50), rate_hz=10.0), small)
    npt.assert_allclose(scaled["B"].value, 1e-7 * base["B"].value, atol=1e-17)
    npt.assert_allclose(scaled["level"].value, 1e-7 * (base["level"].value + 50), rtol=1e-9)
    npt.assert_allclose(scaled.bias.error, 1e-7 * base.bias.error, rtol=1e-9)


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        ("N=1 + K=0.1", ("K",)),
        ("N=1 + GM(sigma=1, T=5) + GM(sigma=2, T=300)", ("GM1", "GM2")),
        ("Q=0.05 + N=1 + B=0.5 + K=0.05", ("bias",)),
    ],
)
def test_standard_errors_have_the_nominal_coverage(text: str, keys: tuple[str, ...]) -> None:
    """95 % of the true states are within 1.96 standard errors."""
    model, rng, n = NoiseModel.parse(text), np.random.default_rng(47), 4000
    inside = []
    for _ in range(30):
        truth = {key: np.zeros(n) for key in ("K", "B", "GM1", "GM2", "noise")}
        gm = 0
        for term in model.terms:
            gm += term.symbol == "GM"
            key = {"GM": f"GM{gm}", "Q": "noise", "N": "noise"}.get(term.symbol, term.symbol)
            truth[key] += term.simulate(n, 0.1, rng)
        samples = np.sum(list(truth.values()), axis=0)
        parts = decompose(AxisSeries.from_samples(samples, rate_hz=10.0), model)
        truth["bias"] = samples - truth["noise"]
        inside += [
            np.abs(parts[key].value - truth[key])[200::400] < 1.96 * parts[key].error[200::400]
            for key in keys
        ]
    # Slow states hardly vary in a record, so the standard error is computed from records (four of them).
    shares = np.mean(inside, axis=1).reshape(30, -1).mean(axis=1)
    assert shares.mean() == pytest.approx(0.95, abs=4 * shares.std() / np.sqrt(30) + 0.005)
    assert shares.std() / np.sqrt(30) < 0.03


def test_a_fit_is_decomposed_by_its_model() -> None:
    """Spikes count as missing samples unless `clean=False`."""
    model = NoiseModel.parse("N=1e-3 + K=1e-4")
    samples = model.simulate(20_000, rate_hz=10.0, rng=np.random.default_rng(48))
    samples[[0, 5000]] = 5.0
    series = AxisSeries.from_samples(samples, rate_hz=10.0)
    found = fit(series, model="N + K")
    parts = decompose(series, found)
    assert parts.model == found.model
    assert parts.start_s == pytest.approx(0.1)
    assert np.isnan(parts.samples[4999])
    assert abs(parts.bias.value[4999] - parts.bias.value[4998]) < parts.bias.error[4999]
    spoilt = decompose(series, found, clean=False)
    assert spoilt.start_s == 0
    assert spoilt.samples[5000] == 5.0


def test_the_cost_is_proportional_to_the_number_of_samples() -> None:
    """The number of transforms does not depend on the number of samples; each one reports its end."""
    counts = []
    for n in (2_000, 20_000):
        samples = np.random.default_rng(49).standard_normal(n)
        progress = mock.Mock()
        decompose(
            AxisSeries.from_samples(samples, rate_hz=1.0),
            NoiseModel.parse("N=1 + K=1e-3"),
            progress=progress,
        )
        counts.append(progress.call_count)
    assert counts[0] == counts[1]


def test_progress_is_reported_up_to_the_end() -> None:
    reports: list[tuple[int, int]] = []
    samples = np.random.default_rng(50).standard_normal(1000)
    series = AxisSeries.from_samples(samples, rate_hz=1.0)
    decompose(series, NoiseModel.parse("N=1"), progress=lambda done, total: reports.append((done, total)))
    assert reports[-1] == (1000, 1000)


def test_a_fit_of_another_rate_is_rejected() -> None:
    """The fit of one log must not be applied to the samples of another."""
    samples = np.random.default_rng(51).standard_normal(2000)
    found = fit(AxisSeries.from_samples(samples, rate_hz=50.0), model="N")
    message = "gyro_x: samples at 100 Hz, but the fit is for 50 Hz"
    with pytest.raises(ValueError, match=re.escape(message)):
        decompose(AxisSeries.from_samples(samples, rate_hz=100.0), found)


@pytest.mark.parametrize("model", ["N=0", "N=0 + R=0", "N=0 + R=1"])
def test_a_model_without_noise_is_rejected(model: str) -> None:
    series = AxisSeries.from_samples(np.arange(9.0), rate_hz=1.0)
    with raises(DataError, "no noise", place="gyro_x"):
        decompose(series, NoiseModel.parse(model))


def test_a_nearly_empty_record_is_rejected() -> None:
    """It has fewer than two samples, or more than 20 times as many missing samples."""
    model = NoiseModel.parse("N=1")
    with raises(DataError, "at least 2 samples, got 1", place="gyro_x"):
        decompose(AxisSeries.from_samples(np.array([1.0, np.nan]), rate_hz=1.0), model)
    keep = np.zeros(1000, dtype=bool)
    keep[[0, 1, 999]] = True
    sparse = AxisSeries.from_samples(np.arange(1000.0), rate_hz=2.0).keeping(keep)
    message = "gyro_x: 3 samples in 500 s at 2 Hz are mostly gaps; use a part of the record with fewer gaps"
    with pytest.raises(DataError, match=re.escape(message)):
        decompose(sparse, model, clean=False)


def test_the_error_for_an_unknown_part_lists_the_parts() -> None:
    with pytest.raises(KeyError, match="'K'; the decomposition has level, B, bias"):
        _ = _decomposed("N=1 + B=1", 100, 52)["K"]


def test_conjugate_gradients_that_do_not_converge_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The numbers would be wrong."""
    monkeypatch.setattr(wiener, "_STEPS", 3)
    monkeypatch.setattr(wiener, "_MAX_DRAWS", 12)
    keep = np.random.default_rng(53).random(2000) < 0.5
    series = AxisSeries.from_samples(np.arange(2000.0) ** 2, rate_hz=1.0).keeping(keep)
    message = (
        r"^gyro_x: \d+ missing samples could not be estimated in 3 steps of conjugate gradients; use a part"
    )
    with pytest.raises(DataError, match=message):
        decompose(series, NoiseModel.parse("Q=1 + N=0.1 + K=0.1"), clean=False)


def test_units_do_not_matter_with_many_gaps() -> None:
    """Conjugate gradients stop at a fraction of the standard error, in every unit."""
    model, small = NoiseModel.parse("N=1 + B=0.5"), NoiseModel.parse("N=1e-7 + B=5e-8")
    rng = np.random.default_rng(54)
    samples, keep = model.simulate(2000, rate_hz=10.0, rng=rng), rng.random(2000) < 0.7
    base = decompose(AxisSeries.from_samples(samples, rate_hz=10.0).keeping(keep), model)
    scaled = decompose(AxisSeries.from_samples(1e-7 * samples, rate_hz=10.0).keeping(keep), small)
    npt.assert_allclose(scaled.bias.value, 1e-7 * base.bias.value, atol=1e-15)
    npt.assert_allclose(scaled.bias.error, 1e-7 * base.bias.error, rtol=1e-9)
