"""Simulated NEES of a factor graph of GTSAM at rest, which is aided in attitude and then coasts.

There is a node per second, with a `CombinedImuFactor` of the second's gyroscope samples between two nodes.
Each attitude is measured for five minutes; then the graph coasts, and only the last node is evaluated.
Positions and the accelerometer are so uncertain that they do not determine the attitude.
"""

from collections.abc import Callable, Mapping
from importlib.metadata import version

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

import imucal
from imucal import NoiseModel
from imucal.arrays import FloatArray
from imucal.fitting import NoiseFit
from tests.benchmarks.aided_filter import Aiding, nees

__all__ = ["attitude_nees"]

#: Simulated model, duration of the fitted records in s, and sampling rate.
TRUTH, FITTED_S, RATE = "N=1e-3 + B=3e-4", 3 * 3600, 10
AIDING, COAST_S = Aiding(2e-3, 300), 60
#: Deviation of positions in m, and the accelerometer's density in m/s²/sqrt(Hz), both uninformative.
_LOOSE = 1e3
_GRAVITY = np.array([0.0, 0.0, 9.80665])


def attitude_nees(
    rules: Mapping[str, Callable[[NoiseFit], tuple[float, float]]], *, count: int, runs: int, seed: int
) -> None:
    """Print, for the fits of `count` records, the NEES of `runs` simulated coasts each and the exact one.

    A run has three axes: the standard error of a row's NEES is its value times sqrt(2 / (3 runs)).
    """
    model = NoiseModel.parse(TRUTH)
    print(f"\n{TRUTH}, {FITTED_S / 3600:g} h; gtsam {version('gtsam')}, seed {seed}: NEES of the attitude")
    print(f"after {COAST_S} s of coasting, {runs} runs a record (a filter of angle and bias, exact)\n")
    print(f"| record | {' | '.join(rules)} |\n|{'---|' * (len(rules) + 1)}")
    for record in range(count):
        rng = np.random.default_rng([seed, record])
        samples = model.simulate(FITTED_S * RATE, rate_hz=RATE, rng=rng)
        fit = imucal.fit(imucal.AxisSeries.from_samples(samples, rate_hz=RATE, sensor="gyroscope", axis="x"))
        seconds = AIDING.updates + COAST_S
        gyro = model.simulate(3 * runs * seconds * RATE, rate_hz=RATE, rng=rng)
        angles = AIDING.sd * rng.standard_normal((runs, AIDING.updates + 1, 3))
        cells = []
        for rule in rules.values():
            pair = rule(fit)
            drawn = [
                normalised_error(*pair, rates, seen)
                for rates, seen in zip(gyro.reshape(runs, 3, -1).swapaxes(1, 2), angles, strict=True)
            ]
            exact = nees(np.array([pair]), model, rate_hz=RATE, aiding=AIDING, coasts_s=[COAST_S])
            cells.append(f"{np.mean(drawn):.2f} ({exact[0, 0]:.2f})")
        print(f"| {record + 1} | {' | '.join(cells)} |", flush=True)


def parameters(N: float, K: float) -> "gtsam.PreintegrationCombinedParams":
    """Return preintegration parameters with these numbers of the gyroscope."""
    found = gtsam.PreintegrationCombinedParams.MakeSharedU(_GRAVITY[2])
    found.setGyroscopeCovariance(N**2 * np.eye(3))
    found.setBiasOmegaCovariance(K**2 * np.eye(3))
    found.setAccelerometerCovariance(_LOOSE**2 * np.eye(3))
    found.setBiasAccCovariance(1e-12 * np.eye(3))
    found.setIntegrationCovariance(1e-12 * np.eye(3))
    # The default of GTSAM 4.2 is the identity: an uncertainty of a radian in each factor.
    if hasattr(found, "setBiasAccOmegaInit"):
        found.setBiasAccOmegaInit(1e-24 * np.eye(6))
    return found


def normalised_error(N: float, K: float, rates: FloatArray, seen: FloatArray) -> float:
    """Return e' P^-1 e / 3 of the last attitude's error; `rates` (samples, 3), `seen` (updates + 1, 3)."""
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    params, free = parameters(N, K), gtsam.imuBias.ConstantBias()
    place = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([AIDING.sd, _LOOSE], 3))
    resting = np.tile(_GRAVITY, (RATE, 1))
    for node in range(len(rates) // RATE + 1):
        start.insert(X(node), gtsam.Pose3())
        start.insert(V(node), np.zeros(3))
        start.insert(B(node), free)
        if node <= AIDING.updates:
            pose = gtsam.Pose3(gtsam.Rot3.Expmap(seen[node]), np.zeros(3))
            graph.add(gtsam.PriorFactorPose3(X(node), pose, place))
        if not node:
            graph.add(gtsam.PriorFactorVector(V(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, _LOOSE)))
            unknown = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([1e-3, 1e4 * N], 3))
            graph.add(gtsam.PriorFactorConstantBias(B(0), free, unknown))
            continue
        between = gtsam.PreintegratedCombinedMeasurements(params, free)
        for force, rate in zip(resting, rates[(node - 1) * RATE : node * RATE], strict=True):
            between.integrateMeasurement(force, rate, 1 / RATE)
        graph.add(
            gtsam.CombinedImuFactor(X(node - 1), V(node - 1), X(node), V(node), B(node - 1), B(node), between)
        )
    found = gtsam.GaussNewtonOptimizer(graph, start).optimize()
    covariance = gtsam.Marginals(graph, found).marginalCovariance(X(node))[:3, :3]
    error = gtsam.Rot3.Logmap(found.atPose3(X(node)).rotation())
    return float(error @ np.linalg.solve(covariance, error)) / 3
