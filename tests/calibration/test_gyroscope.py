"""Gyroscope: bias and g-sensitivity at rest, scale and misalignment from turns."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from imucal.arrays import FloatArray
from imucal.calibration.accelerometer import AccelerometerFit, fit_accelerometer
from imucal.calibration.gravity import EARTH_RATE, EarthRate, earth_rate
from imucal.calibration.gyro_rest import GyroRest, estimate_gyro_rest
from imucal.calibration.mean_covariance import mean_covariance
from imucal.calibration.poses import RestMeans, Triad
from imucal.calibration.slow_noise import walk_covariance
from imucal.calibration.turn_data import Headings, TurnData, prepare_turns, rotations, start_of
from imucal.calibration.turns import (
    GyroNoise,
    TurnsFit,
    _carry,
    _rotation_vectors,
    direction_covariance,
    fit_turns,
)
from imucal.errors import DataError
from imucal.noise import NoiseModel
from imucal.recording import Sensor
from tests.calibration.simulated import GRAVITY, RATE, Log, Truth, attitudes, log, within_binomial

NOISE = NoiseModel.parse("N=2e-3 + B=5e-4 + K=5e-5"), NoiseModel.parse("N=1.5e-4 + B=2e-5 + K=2e-6")
QUIET = NoiseModel.parse("N=1e-7"), NoiseModel.parse("N=1e-8")
LATITUDE = 47.4


@dataclass(frozen=True)
class Chain:
    """A log that went through all steps."""

    truth: Truth
    log: Log
    accelerometer: AccelerometerFit
    rest: GyroRest
    data: TurnData
    noise: GyroNoise
    directions: FloatArray

    def fit(self) -> TurnsFit:
        return fit_turns(self.data, self.noise, self.directions)


def chain(
    seed: int,
    noise: tuple[NoiseModel, NoiseModel] = NOISE,
    count: int = 12,
    earth: EarthRate | None = None,
    spoil: tuple[int, float] | None = None,
) -> Chain:
    """Return a drawn log after each step; `spoil` clips one turn at a share of its peak."""
    rng = np.random.default_rng(seed)
    truth = Truth.draw(rng)
    one = log(truth, noise, attitudes(count, rng), rng, latitude=LATITUDE)
    gyroscope = one.gyroscope.copy()
    if spoil is not None:
        turn = slice(one.spans[spoil[0], 1], one.spans[spoil[0] + 1, 0])
        limit = spoil[1] * np.abs(gyroscope[turn]).max()
        gyroscope[turn] = np.clip(gyroscope[turn], -limit, limit)
    n, spans = len(one.f), one.spans
    means, rates = (np.array([x[a:b].mean(axis=0) for a, b in spans]) for x in (one.accelerometer, gyroscope))
    K_a, K_g = (np.array([mean_covariance(model, spans, rate_hz=RATE, samples=n)] * 3) for model in noise)
    fit = fit_accelerometer(means, K_a, gravity=GRAVITY)
    walk = walk_covariance(spans, rate_hz=RATE, samples=n)
    rest = estimate_gyro_rest(
        rates,
        fit.f,
        K_g,
        walk,
        scale=np.eye(3),
        earth=earth or earth_rate(LATITUDE),
        gravity=GRAVITY,
        checked=True,
    )
    f = (one.accelerometer - fit.b) @ fit.C.T
    data = prepare_turns(
        Triad(sensor=Sensor.GYROSCOPE, samples=gyroscope, rate_hz=RATE),
        RestMeans(spans=spans, means=rates, deviations=np.ones(3)),
        fit.up,
        np.arange(count - 1),
        (f @ rest.G_apparent.T, fit.f @ rest.G_apparent.T),
    )
    return Chain(
        truth=truth,
        log=one,
        accelerometer=fit,
        rest=rest,
        data=data,
        noise=GyroNoise(models=(noise[1],) * 3, tau=np.zeros(3), rest_spans=spans, samples=n),
        directions=direction_covariance(fit, means, K_a),
    )


def test_rotations_are_matrix_exponentials() -> None:
    """Rotations, of zero and of large vectors."""
    from scipy.linalg import expm

    vectors = np.array([[0.0, 0, 0], [1e-9, 0, 0], [0.3, -0.2, 0.9], [2.0, 1.0, -2.5]])
    for v, found in zip(vectors, rotations(vectors), strict=True):
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        np.testing.assert_allclose(found, expm(cross), atol=1e-12)


def test_recovers_exact_parameters() -> None:
    """Without noise: what remains is the earth's horizontal rate."""
    one = chain(7000, QUIET, count=14)
    np.testing.assert_allclose(one.fit().C, np.linalg.inv(one.truth.M_g), atol=2e-4)
    np.testing.assert_allclose(one.rest.G_estimate, one.truth.G, atol=1e-5)
    np.testing.assert_allclose(one.rest.b, one.log.b_g, atol=5e-5)


def test_derivatives_are_those_of_finite_differences() -> None:
    """Of the residuals in the nine entries of C."""
    one = chain(7001, count=6)
    C = np.eye(3) + 0.01 * np.arange(9).reshape(3, 3)
    # The formula is exact for small steps of rotation; samples at 100 Hz turn by up to a degree.
    J = _carry(one.data, C).J
    for k in range(9):
        step = 1e-6 * np.eye(9)[k].reshape(3, 3)
        found = (_carry(one.data, C + step).residual - _carry(one.data, C - step).residual).ravel() / 2e-6
        np.testing.assert_allclose(J[:, k], found, atol=0.03)


def test_coverage_of_every_parameter() -> None:
    """Consumer noise, 12 rests, the whole chain."""
    C, G, b = [], [], []
    for seed in range(15):
        one = chain(710_000 + seed)
        fit, rest = one.fit(), one.rest
        C.append(
            np.abs(fit.C - np.linalg.inv(one.truth.M_g)).ravel()
            < fit.quantile * np.sqrt(np.diag(fit.covariance))
        )
        G.append(((rest.G_interval[..., 0] < one.truth.G) & (rest.G_interval[..., 1] > one.truth.G)).ravel())
        b.append((rest.b_interval[:, 0] < one.log.b_g) & (one.log.b_g < rest.b_interval[:, 1]))
    assert within_binomial(np.array(C), 0.93, 0.98)
    assert within_binomial(np.array(G), 0.93, 0.98)
    assert within_binomial(np.array(b), 0.93, 0.98)


def test_a_clipped_turn_is_excluded() -> None:
    """Clipped at 90 % of its peak: that turn and no other."""
    for seed in range(4):
        one = chain(7100 + seed, count=16, spoil=(5, 0.9))
        assert np.flatnonzero(~one.fit().used).tolist() == [5]


def test_no_turn_is_excluded_from_good_logs() -> None:
    """Four logs of 11 turns."""
    assert all(chain(7200 + seed).fit().used.all() for seed in range(4))


@pytest.mark.parametrize("scale", [1 / 4770, 57.29578])
def test_raw_units_find_their_scale(scale: float) -> None:
    """Counts, and deg/s."""
    one = chain(7300)
    # C is in rad/s per raw unit.
    raw = replace(one.data, rates=one.data.rates / scale)
    np.testing.assert_allclose(start_of(raw), scale * np.eye(3), atol=0.1 * scale)


def test_exchanged_and_mirrored_axes_are_found() -> None:
    """The gyroscope's x is -y of the accelerometer, and y is x."""
    one = chain(7400, count=14)
    turned = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    start = start_of(replace(one.data, rates=one.data.rates @ turned.T))
    np.testing.assert_allclose(start @ turned, np.eye(3), atol=0.15)


def test_rates_of_another_log_explain_nothing() -> None:
    """Noise instead of rates."""
    one = chain(7500)
    noise = np.random.default_rng(1).normal(0, 1, one.data.rates.shape)
    with pytest.raises(DataError, match="explains the turns"):
        start_of(replace(one.data, rates=noise))


def test_a_single_turn_leaves_most_unobservable() -> None:
    """Two residuals cannot determine nine parameters."""
    one = chain(7600)
    fit = fit_turns(one.data.keeping(np.arange(11) == 3), one.noise, one.directions)
    assert fit.statuses.count("not-observable") >= 7
    unseen = np.reshape([status == "not-observable" for status in fit.statuses], (3, 3))
    np.testing.assert_array_equal(fit.C[unseen], np.eye(3)[unseen])


@pytest.mark.parametrize("scale", [1.0, 3000.0])
def test_few_turns_are_never_worse_than_none(scale: float) -> None:
    """Two turns of a gyroscope in rad/s or in counts: what they do not show stays the identity."""
    for seed in range(7610, 7616):
        one = chain(seed)
        data = replace(one.data.keeping(np.arange(11) < 2), rates=scale * one.data.rates[:2])
        models = tuple(
            NoiseModel(terms=tuple(type(t).of(scale * t.coefficient) for t in model.terms))
            for model in one.noise.models
        )
        fit = fit_turns(data, replace(one.noise, models=models), one.directions)
        truth = np.linalg.inv(one.truth.M_g)
        C = fit.C * scale
        # Counts have no scale before the turns, which show that of one or two axes.
        common = 1.0 if scale == 1.0 else np.trace(C) / 3
        assert common == pytest.approx(np.trace(truth) / 3, rel=0.03)
        unturned = common * np.eye(3)
        assert np.abs(C - truth).max() < 1.1 * np.abs(unturned - truth).max()
        off_diagonal = ~np.eye(3, dtype=bool)
        unseen = np.reshape([status == "not-observable" for status in fit.statuses], (3, 3)) & off_diagonal
        assert unseen.any()
        assert np.all(C[unseen] == 0)


def test_insignificant_g_sensitivity_is_not_applied() -> None:
    """A gyroscope without any: G is 0 in most logs, and the bias covers."""
    applied, inside = [], []
    for seed in range(100):
        rng = np.random.default_rng(7700 + seed)
        m = 12
        f = attitudes(m, rng) * GRAVITY
        K = 1e-4**2 * np.eye(m)
        rest = estimate_gyro_rest(
            0.01 + rng.normal(0, 1e-4, (m, 3)),
            f,
            np.array([K] * 3),
            np.eye(m),
            scale=np.eye(3),
            earth=EarthRate(vertical=0.0, vertical_sigma=0.0, horizontal_sigma=0.0),
            gravity=GRAVITY,
            checked=True,
        )
        applied.append(rest.significant)
        inside.append((rest.b_interval[:, 0] < 0.01) & (rest.b_interval[:, 1] > 0.01))
        assert rest.significant or not rest.G.any()
    assert np.mean(applied) < 0.1
    assert within_binomial(np.array(inside), 0.93, 1.0)


def test_few_attitudes_determine_the_bias_only() -> None:
    """Three directions: no g-sensitivity, but a bias."""
    f = np.tile(np.eye(3)[:2] * GRAVITY, (4, 1))
    rest = estimate_gyro_rest(
        np.full((8, 3), 0.02) + np.random.default_rng(2).normal(0, 1e-5, (8, 3)),
        f,
        np.array([1e-10 * np.eye(8)] * 3),
        np.eye(8),
        scale=np.eye(3),
        earth=earth_rate(LATITUDE),
        gravity=GRAVITY,
        checked=True,
    )
    assert np.isnan(rest.G_estimate).all()
    assert not rest.G.any()
    np.testing.assert_allclose(rest.b, 0.02, atol=2e-4)


def test_an_unknown_latitude_costs_certainty_of_g() -> None:
    """The vertical rate looks like a multiple of the identity."""
    known, unknown = chain(7800), chain(7800, earth=earth_rate(None))
    assert known.rest.earth_share == 0
    assert unknown.rest.earth_share > 0.2
    wide, narrow = (np.diff(one.rest.G_interval)[..., 0] for one in (unknown, known))
    assert np.all(np.diag(wide) > 1.1 * np.diag(narrow))


@pytest.mark.slow
def test_wrong_turns_and_false_alarms_in_100_logs() -> None:
    """A turn clipped at 90 % of its peak: found in 98 or more; another turn is blamed in one log at most."""
    found = false = 0
    for seed in range(100):
        excluded = set(np.flatnonzero(~chain(720_000 + seed, count=16, spoil=(5, 0.9)).fit().used).tolist())
        found += 5 in excluded
        false += bool(excluded - {5})
    assert found >= 98
    assert false <= 1


def test_headings_are_carried_through_turns() -> None:
    """The earth's horizontal rate at each rest follows from one heading; a missing turn begins another."""
    one = chain(7900, QUIET, count=10)
    up = np.array([one.log.f[a] for a, _ in one.log.spans]) / GRAVITY
    rates = np.array([one.log.gyroscope[a:b].mean(axis=0) for a, b in one.log.spans])
    M, b, G = one.truth.M_g, one.truth.b_g, one.truth.G
    earth = (rates - b - up * GRAVITY @ G.T) @ np.linalg.inv(M).T
    horizontal = earth - up * np.einsum("mi,mi->m", earth, up)[:, None]
    np.testing.assert_allclose(
        np.linalg.norm(horizontal, axis=1), EARTH_RATE * np.cos(np.radians(LATITUDE)), rtol=2e-3
    )
    C = np.eye(3)
    covariance = Headings.of(one.data, C).covariance
    whole = covariance.sum(axis=0) / 2
    # The covariance has two heading directions: what it cannot explain is the error of carrying.
    for axis in range(3):
        values, vectors = np.linalg.eigh(covariance[axis])
        assert np.sum(values > 1e-9 * values.max()) == 2
        explained = vectors[:, -2:] @ vectors[:, -2:].T @ horizontal[:, axis]
        np.testing.assert_allclose(explained, horizontal[:, axis], atol=0.04 * EARTH_RATE)
    np.testing.assert_allclose(np.diag(whole), 1.0)
    broken = Headings.of(one.data.keeping(np.arange(9) != 4), C).covariance
    assert not broken[:, :5, 5:].any()
    np.testing.assert_allclose(broken[:, :5, :5], covariance[:, :5, :5])


def test_the_rotation_of_a_fast_turn_is_of_fourth_order() -> None:
    """Half the period reduces the error of a turn about a moving axis by a factor of 8 or more."""

    def turned(samples: int) -> FloatArray:
        t = (np.arange(samples) + 0.5) / samples
        bell, sine = 1 - np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)
        moving = np.outer(sine, [1.0, 2.0, -2.0]) + np.outer(t, [0.5, 1.0, 3.0])
        rates = bell[:, None] * (moving + np.array([2.0, -1.0, 0.5]))
        whole = np.eye(3)
        for step in rotations(-_rotation_vectors(rates[None] / samples)[0]):
            whole = step @ whole
        return whole

    exact = turned(4000)
    errors = [float(np.linalg.norm(turned(samples) - exact)) for samples in (20, 40, 80)]
    assert errors[0] < 3e-3
    assert errors[1] < errors[0] / 8
    assert errors[2] < errors[1] / 8
