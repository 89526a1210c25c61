"""Coverage of calibration intervals, next to white-noise intervals on the same draws; and two real logs.

    python tests/benchmarks/calibration.py [--records N] [--seed S] [--only PART...]

Parts: accelerometer, gyroscope, faults, fixture, real; and, by the whole command, hand, gauss-markov, earth,
warming, faces, fast, sensitivity, frames.
"""

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import imucal
from imucal.arrays import BoolArray, FloatArray
from imucal.calibration import Calibration
from imucal.calibration.accelerometer import LOWER, derivatives, fit_accelerometer
from imucal.calibration.calibrating import calibrate
from imucal.calibration.frames import FRAMES
from imucal.calibration.gravity import earth_rate
from imucal.calibration.gyro_rest import estimate_gyro_rest
from imucal.calibration.mean_covariance import mean_covariance, white_model
from imucal.calibration.noise_source import _model
from imucal.calibration.poses import RestMeans, Triad, half_differences, moved_rests, triad
from imucal.calibration.slow_noise import AccelerometerEstimate, estimate_accelerometer, walk_covariance
from imucal.calibration.turn_data import Headings, prepare_turns, start_of
from imucal.calibration.turns import GyroNoise, TurnsFit, _carry, _covariance, direction_covariance, fit_turns
from imucal.errors import DataError
from imucal.noise import NoiseModel
from imucal.recording import AXES, Sensor
from tests.calibration.simulated import (
    FACES,
    GRAVITY,
    RATE,
    Log,
    Truth,
    accelerometer_rests,
    attitudes,
    covered,
    held,
    log,
    spans_of,
    truth_inside,
    warmed,
)
from tests.real_data import real_data

#: Noise of an accelerometer and of a gyroscope.
SENSORS = {
    "white": ("N=2e-3", "N=1.5e-4"),
    "consumer": ("N=2e-3 + B=5e-4 + K=5e-5", "N=1.5e-4 + B=2e-5 + K=2e-6"),
    "drifty": ("N=1.5e-3 + B=1e-3 + K=3e-4", "N=2e-4 + B=1e-4 + K=2e-5"),
    "adis": ("N=5e-3 + B=4e-3", "N=7e-4 + B=2e-4 + K=1.5e-5"),
}
#: Number of rests and their length in s.
CELLS = ((9, 5.0), (12, 5.0), (20, 5.0), (20, 30.0))
LATITUDE = 47.4
#: Reports of 30 min that are fitted for each noise; each draw takes three of them.
REPORTS = 9


def halved(model: NoiseModel) -> NoiseModel:
    """Return a model with half of B and K."""
    terms = (f"{t.symbol}={t.value / (1 if t.symbol == 'N' else 2)!r}" for t in model.terms)  # type: ignore[attr-defined]
    return NoiseModel.parse(" + ".join(terms))


def reports(model: NoiseModel, seed: int) -> list[NoiseModel]:
    """Return what imucal fits to static logs of 30 min."""
    found = []
    for k in range(REPORTS):
        samples = model.simulate(int(1800 * RATE), rate_hz=RATE, rng=np.random.default_rng(seed + k))
        found.append(_model(imucal.fit(samples, rate_hz=RATE, sensor="accelerometer")))
    return found


def accelerometer(records: int, seed: int) -> None:
    """Print coverage and width (relative to the true model's) of the nine parameters."""
    for name in ("consumer", "drifty", "adis"):
        truth = NoiseModel.parse(SENSORS[name][0])
        fitted = reports(truth, seed)
        only = NoiseModel(terms=truth.terms[:1])
        for count, rest_s in CELLS:
            hits, widths, diagonal = defaultdict(list), defaultdict(list), 0
            for k in range(records):
                rng = np.random.default_rng(seed + k)
                one = accelerometer_rests(truth, count, rest_s, rng)
                K = {
                    model: mean_covariance(model, one.spans, rate_hz=RATE, samples=one.samples)
                    for model in (truth, only, halved(truth), *fitted)
                }
                white = [white_model(float(s), RATE) for s in one.deviations]
                own = np.array(
                    [mean_covariance(m, one.spans, rate_hz=RATE, samples=one.samples) for m in white]
                )
                walk = walk_covariance(one.spans, rate_hz=RATE, samples=one.samples)
                drawn = rng.choice(REPORTS, 3, replace=False)
                bases = {
                    "30 min report": (np.array([K[fitted[i]] for i in drawn]), True),
                    "B, K halved": (np.array([K[halved(truth)]] * 3), True),
                    "N only": (np.array([K[only]] * 3), True),
                    "no report": (own, False),
                }
                best = fit_accelerometer(one.means, np.array([K[truth]] * 3), gravity=GRAVITY)
                for what, (base, checked) in bases.items():
                    found = estimate_accelerometer(one.means, base, walk, gravity=GRAVITY, checked=checked)
                    if "diagonal" in {found.fit.model, best.model}:
                        diagonal += 1
                        continue
                    interval = found.mixture.interval(np.eye(9))
                    hits[what].append(covered(found.theta, interval, one.true))
                    sd = np.sqrt(np.diag(best.covariance))
                    widths[what].append((interval[:, 1] - interval[:, 0]) / 3.92 / sd)
                fit = fit_accelerometer(one.means, own, gravity=GRAVITY)
                hits["white noise"].append(
                    np.abs(fit.theta - one.true) < 1.96 * np.sqrt(np.diag(fit.covariance))
                )
            text = "  ".join(
                f"{what} {100 * np.mean(h):.1f} %"
                + (f" ({np.median(widths[what]):.2f})" if what in widths else "")
                for what, h in hits.items()
            )
            print(f"accelerometer {name} {count} x {rest_s:g} s: {text}; diagonal {diagonal}", flush=True)


class Found(NamedTuple):
    """C by rows (9,) and its half-widths, intervals of G (9, 2) and b (3, 2), and the turns used."""

    C: FloatArray
    half: FloatArray
    G: FloatArray
    b: FloatArray
    used: BoolArray


def white_rest(means: FloatArray, f: FloatArray, K: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return intervals of G (9, 2) and b (3, 2) by weighted least squares with independent white noise."""
    X = np.column_stack([np.ones(len(f)), f])
    earth = earth_rate(LATITUDE).vertical / GRAVITY * np.eye(3)
    low, high = np.empty((3, 4)), np.empty((3, 4))
    for axis in range(3):
        weight = 1 / np.diag(K[axis])
        covariance = np.linalg.inv((X.T * weight) @ X)
        theta = covariance @ (X.T @ (weight * means[:, axis]))
        theta[1:] -= earth[axis]
        half = 1.96 * np.sqrt(np.diag(covariance))
        low[axis], high[axis] = theta - half, theta + half
    both = np.stack([low, high], axis=-1)
    return both[:, 1:].reshape(9, 2), both[:, 0]


def one_chain(one: Log, models: tuple[NoiseModel, NoiseModel], *, white: bool = False) -> Found:
    """Return the result of all steps; with white noise and exact directions if `white`."""
    n, spans = len(one.f), one.spans
    data = [
        Triad(sensor=s, samples=x, rate_hz=RATE)
        for s, x in ((Sensor.ACCELEROMETER, one.accelerometer), (Sensor.GYROSCOPE, one.gyroscope))
    ]
    rests = [RestMeans.of(d, spans / RATE) for d in data]
    used = [
        [white_model(float(s), RATE) for s in r.deviations] if white else [m] * 3
        for r, m in zip(rests, models, strict=True)
    ]
    K_a, K_g = (np.array([mean_covariance(m, spans, rate_hz=RATE, samples=n) for m in own]) for own in used)
    fit = fit_accelerometer(rests[0].means, K_a, gravity=GRAVITY)
    which, earth = np.arange(len(spans) - 1), earth_rate(LATITUDE)
    plain = prepare_turns(data[1], rests[1], fit.up, which)
    headings = Headings.of(plain, start_of(plain))
    rest = estimate_gyro_rest(
        rests[1].means,
        fit.f,
        K_g,
        walk_covariance(spans, rate_hz=RATE, samples=n),
        scale=np.eye(3),
        earth=earth,
        gravity=GRAVITY,
        checked=True,
        headings=headings,
    )
    f = (one.accelerometer - fit.b) @ fit.C.T
    parts = f @ rest.G_apparent.T, fit.f @ rest.G_apparent.T
    arrays = prepare_turns(data[1], rests[1], fit.up, which, parts)
    noise = GyroNoise(
        models=tuple(used[1]),
        tau=np.zeros(3),
        rest_spans=spans,
        samples=n,
        headings=headings,
        horizontal=earth.horizontal_sigma,
    )
    directions = direction_covariance(fit, rests[0].means, K_a)
    turns = fit_turns(arrays, noise, 0 * directions if white else directions)
    # Other tools do not widen intervals by the misfit.
    widening, quantile = (turns.widening, 1.96) if white else (1.0, turns.quantile)
    half = quantile * np.sqrt(np.diag(turns.covariance)) / widening
    G, b = rest.G_interval.reshape(9, 2), rest.b_interval
    if white:
        G, b = white_rest(rests[1].means, fit.f, K_g)
    return Found(turns.C.ravel(), half, G, b, turns.used)


def gyroscope(records: int, seed: int) -> None:
    """Print coverage of C, G and b over all steps; white: white noise only, exact directions."""
    for name, texts in SENSORS.items():
        models = NoiseModel.parse(texts[0]), NoiseModel.parse(texts[1])
        for count, rest_s in ((12, 5.0), (20, 10.0)):
            hits, excluded = defaultdict(list), 0
            for k in range(records):
                rng = np.random.default_rng(seed + k)
                truth = Truth.draw(rng)
                one = log(truth, models, attitudes(count, rng), rng, rest_s=rest_s, latitude=LATITUDE)
                for white in (False, True):
                    C, half, G, b, used = one_chain(one, models, white=white)
                    label = "white " if white else ""
                    hits[f"{label}C"].append(np.abs(C - np.linalg.inv(truth.M_g).ravel()) < half)
                    hits[f"{label}G"].append((G[:, 0] < truth.G.ravel()) & (truth.G.ravel() < G[:, 1]))
                    hits[f"{label}b"].append((b[:, 0] < one.b_g) & (one.b_g < b[:, 1]))
                    excluded += 0 if white else int(np.sum(~used))
            text = "  ".join(f"{what} {100 * np.mean(h):.1f} %" for what, h in hits.items())
            print(
                f"gyroscope {name} {count} x {rest_s:g} s: {text}; good turns excluded {excluded}", flush=True
            )


def faults(records: int, seed: int) -> None:
    """Print detection rates of a clipped turn and a creeping rest, and false alarms."""
    models = NoiseModel.parse(SENSORS["consumer"][0]), NoiseModel.parse(SENSORS["consumer"][1])
    counts = dict.fromkeys(("turn found", "turn blamed", "rest found", "rest blamed"), 0)
    for k in range(records):
        rng = np.random.default_rng(seed + k)
        one = log(Truth.draw(rng), models, attitudes(16, rng), rng, latitude=LATITUDE)
        a, b = one.spans[5, 1], one.spans[6, 0]
        limit = 0.9 * np.abs(one.gyroscope[a:b]).max()
        one.gyroscope[a:b] = np.clip(one.gyroscope[a:b], -limit, limit)
        wrong = set(np.flatnonzero(~one_chain(one, models).used).tolist())
        counts["turn found"] += 5 in wrong
        counts["turn blamed"] += bool(wrong - {5})
        a, b = one.spans[8]
        axis = np.cross(one.f[a], rng.normal(size=3))
        angle = np.radians(0.2) * np.linspace(0, 1, b - a)
        one.accelerometer[a:b] += angle[:, None] * np.cross(axis / np.linalg.norm(axis), one.f[a])
        data = Triad(sensor=Sensor.ACCELEROMETER, samples=one.accelerometer, rate_hz=RATE)
        rests = RestMeans.of(data, one.spans / RATE)
        moved = set(np.flatnonzero(moved_rests(half_differences(data, rests, (models[0],) * 3))).tolist())
        counts["rest found"] += 8 in moved
        counts["rest blamed"] += bool(moved - {8})
    print(f"faults, of {records}: {counts}", flush=True)


def fixture(records: int, seed: int) -> None:
    """Print the worst error of |f| after 18 rests, and after six assumed directions tilted by 1°."""
    model = NoiseModel.parse(SENSORS["consumer"][0])
    worst = defaultdict(list)
    for k in range(records):
        rng = np.random.default_rng(seed + k)
        truth = Truth.draw(rng)
        probes = rng.normal(size=(200, 3))
        raw = probes / np.linalg.norm(probes, axis=1)[:, None] * GRAVITY @ truth.M_a.T + truth.b_a
        for count in (18, 6):
            up = attitudes(count, rng) if count == 18 else FACES + rng.normal(0, np.radians(1), (6, 3))
            up = up / np.linalg.norm(up, axis=1)[:, None]
            spans = spans_of(count, 5.0)
            n = int(spans[-1, 1])
            noise = np.column_stack([model.simulate(n, rate_hz=RATE, rng=rng) for _ in range(3)])
            means = up * GRAVITY @ truth.M_a.T + truth.b_a + [noise[a:b].mean(axis=0) for a, b in spans]
            if count == 18:
                K = np.array([mean_covariance(model, spans, rate_hz=RATE, samples=n)] * 3)
                fit = fit_accelerometer(means, K, gravity=GRAVITY)
                f = (raw - fit.b) @ fit.C.T
            else:
                P = np.linalg.lstsq(np.column_stack([means, -np.ones(6)]), FACES * GRAVITY)[0]
                f = raw @ P[:3] - P[3]
            worst[count].append(np.abs(np.linalg.norm(f, axis=1) - GRAVITY).max())
    text = ", ".join(
        f"{count} rests: median {np.median(v):.4f}, 95 % {np.quantile(v, 0.95):.4f}"
        for count, v in worst.items()
    )
    print(f"fixture, worst | |f| - g | in m/s²: {text}", flush=True)


#: Start of a parameter's name -> group whose coverage is printed.
GROUPS = {
    "a scale": "C_a", "a misalignment": "C_a", "a bias": "b_a",
    "g scale": "C_g", "g misalignment": "C_g", "g bias": "b_g", "g g": "G",
}  # fmt: skip


def models_of(noise: tuple[NoiseModel, NoiseModel]) -> dict[str, NoiseModel]:
    """Return models by axis name, for noise of the accelerometer and of the gyroscope."""
    return {f"{s.short}_{axis}": noise[s is Sensor.GYROSCOPE] for s in Sensor for axis in AXES}


def whole(
    title: str,
    seeds: Iterable[int],
    draw: Callable[[np.random.Generator], tuple[Truth, Log]],
    run: Callable[[Log, np.random.Generator], Calibration],
    codes: tuple[str, ...] = (),
) -> None:
    """Print coverage by group, the least of one parameter, shares of findings, of G applied, and refusals."""
    hits: dict[str, list[bool]] = defaultdict(list)
    found: dict[str, int] = defaultdict(int)
    applied, refused, widths = [], 0, []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth, one = draw(rng)
        try:
            result = run(one, rng)
        except DataError:
            refused += 1
            continue
        for name, inside in truth_inside(truth, one, result).items():
            hits[name].append(inside)
        for code in {finding.code for finding in result.findings}:
            found[code] += 1
        assert result.gyroscope is not None
        applied.append(result.gyroscope.rest.significant)
        widths.append(
            [
                result.accelerometer.parameters["bias_x"].half_width or 0.0,
                result.gyroscope.parameters["bias_x"].half_width or 0.0,
            ]
        )
    grouped: dict[str, list[bool]] = defaultdict(list)
    for name, each in hits.items():
        grouped[next(group for start, group in GROUPS.items() if name.startswith(start))] += each
    text = ", ".join(f"{group} {100 * np.mean(each):.1f}" for group, each in grouped.items())
    worst = min(hits, key=lambda name: float(np.mean(hits[name])))
    shares = ", ".join(f"{code} {100 * found[code] / max(len(applied), 1):.0f}" for code in codes)
    half = np.median(widths, axis=0)
    least = f"least {worst} {100 * np.mean(hits[worst]):.1f}"
    size = f"half-width of b {1e3 * half[0]:.2g} mm/s², {np.degrees(half[1]):.2g} deg/s"
    applied_in = f"G applied {100 * np.mean(applied):.0f} %"
    print(f"{title}: {text}; {least}; {applied_in}; {size}; {shares}; refused {refused}", flush=True)


def twice(
    title: str,
    seeds: range,
    draw: Callable[[np.random.Generator], tuple[Truth, Log]],
    noise: tuple[NoiseModel, NoiseModel],
    codes: tuple[str, ...] = (),
    *,
    in_hand: bool = False,
) -> None:
    """Print coverage without a noise report and with the true one."""
    for name, report in (("no report", None), ("report", models_of(noise))):

        def run(
            one: Log, _: np.random.Generator, report: dict[str, NoiseModel] | None = report
        ) -> Calibration:
            return calibrate(one.recording(), report, LATITUDE, gravity=GRAVITY, in_hand=in_hand)

        whole(f"{title} {name}", seeds, draw, run, codes)


def of_sensor(name: str) -> tuple[NoiseModel, NoiseModel]:
    """Return the noise of a sensor's accelerometer and gyroscope."""
    accel, gyro = map(NoiseModel.parse, SENSORS[name])
    return accel, gyro


def hand(records: int, seed: int) -> None:
    """Print coverage in a calm and in a shaky hand, with and without a report of a log on a table."""
    noise = of_sensor("consumer")
    for size in (0.5, 1.0):
        for count in (12, 20):

            def draw(rng: np.random.Generator, count: int = count, size: float = size) -> tuple[Truth, Log]:
                truth = Truth.draw(rng)
                one = log(truth, noise, attitudes(count, rng), rng, latitude=LATITUDE)
                return truth, held(one, truth, rng, size=size)

            codes = ("beyond-noise", "rest-moved", "turn-wrong", "noise-differs")
            title = f"hand {size:g} {count} x 5 s"
            twice(title, range(seed, seed + records), draw, noise, codes, in_hand=True)


def gauss_markov(records: int, seed: int) -> None:
    """Print coverage with Gauss-Markov noise, whose report of 30 min shows it as GM, B, K or not at all."""
    for T in (5, 50, 500):
        noise = (
            NoiseModel.parse(f"N=2e-3 + GM(sigma=1e-3, T={T})"),
            NoiseModel.parse(f"N=1.5e-4 + GM(sigma=5e-5, T={T})"),
        )
        fitted = [reports(model, seed) for model in noise]
        print(f"T = {T} s is fitted as {', '.join(sorted({str(m) for own in fitted for m in own}))}")
        for count in (12, 20):

            def draw(
                rng: np.random.Generator,
                count: int = count,
                noise: tuple[NoiseModel, NoiseModel] = noise,
            ) -> tuple[Truth, Log]:
                truth = Truth.draw(rng)
                return truth, log(truth, noise, attitudes(count, rng), rng, latitude=LATITUDE)

            def run(
                one: Log, rng: np.random.Generator, fitted: list[list[NoiseModel]] = fitted
            ) -> Calibration:
                known = {
                    f"{s.short}_{axis}": fitted[s is Sensor.GYROSCOPE][rng.integers(REPORTS)]
                    for s in Sensor
                    for axis in AXES
                }
                return calibrate(one.recording(), known, LATITUDE, gravity=GRAVITY)

            whole(f"GM {T} s {count} x 5 s report", range(seed, seed + records), draw, run, ("beyond-noise",))


def earth(records: int, seed: int) -> None:
    """Print coverage for a quiet gyroscope, whose G the earth's rotation decides."""
    noise = NoiseModel.parse(SENSORS["consumer"][0]), NoiseModel.parse("N=2e-5 + B=1e-6")
    for latitude, yaw in ((0.0, 0.6), (47.4, 0.6), (80.0, 0.6), (0.0, 0.0), (47.4, 0.0)):

        def draw(rng: np.random.Generator, latitude: float = latitude, yaw: float = yaw) -> tuple[Truth, Log]:
            truth = Truth.draw(rng)
            return truth, log(truth, noise, attitudes(18, rng), rng, latitude=latitude, yaw=yaw)

        for known in (latitude, None):
            is_known = "unknown" if known is None else "known"
            whole(
                f"earth {latitude:g} deg, yaw {yaw:g} rad, latitude {is_known}",
                range(seed, seed + records),
                draw,
                lambda one, _, known=known: calibrate(  # type: ignore[misc]
                    one.recording(), models_of(noise), known, gravity=GRAVITY
                ),
                ("earth-rate",),
            )


def warming(records: int, seed: int) -> None:
    """Print coverage, and how often `warming` is found, for biases that settle within 200 s or not at all."""
    noise = of_sensor("consumer")
    for size in ((0.0, 0.0), (5e-3, 2e-4), (2e-2, 1e-3), (8e-2, 4e-3)):

        def draw(rng: np.random.Generator, size: tuple[float, float] = size) -> tuple[Truth, Log]:
            truth = Truth.draw(rng)
            one = log(truth, noise, attitudes(18, rng), rng, latitude=LATITUDE)
            return truth, warmed(one, size, 60.0)

        twice(
            f"warming {1e3 * size[0]:g} mm/s² {np.degrees(size[1]):.2g} deg/s",
            range(seed, seed + records),
            draw,
            noise,
            ("warming", "beyond-noise"),
        )


def faces(records: int, seed: int) -> None:
    """Print coverage for six or eight rests, which do not determine the accelerometer's misalignments."""
    noise = of_sensor("consumer")
    for count in (6, 8):

        def draw(rng: np.random.Generator, count: int = count) -> tuple[Truth, Log]:
            truth = Truth.draw(rng)
            return truth, log(truth, noise, attitudes(count, rng), rng, latitude=LATITUDE)

        codes = ("not-observable", "turn-wrong")
        twice(f"{count} rests on the faces first", range(seed, seed + records), draw, noise, codes)


def fast(records: int, seed: int) -> None:
    """Print coverage for turns of 0.6 s at low sampling rates, without a noise report."""
    noise = of_sensor("consumer")
    for every in (1, 2, 4):

        def draw(rng: np.random.Generator, every: int = every) -> tuple[Truth, Log]:
            truth = Truth.draw(rng)
            one = log(truth, noise, attitudes(16, rng), rng, latitude=LATITUDE, turn_s=0.6, yaw=1.0)
            parts = (one.accelerometer, one.gyroscope, one.f)
            accelerometer, gyroscope, f = (part[::every] for part in parts)
            return truth, replace(one, accelerometer=accelerometer, gyroscope=gyroscope, f=f)

        def run(one: Log, _: np.random.Generator, every: int = every) -> Calibration:
            return calibrate(one.recording(RATE / every), None, LATITUDE, gravity=GRAVITY)

        whole(
            f"turns of 0.6 s at {RATE / every:g} Hz", range(seed, seed + records), draw, run, ("turn-wrong",)
        )


def sensitivity(records: int, seed: int) -> None:
    """Print coverage for small g-sensitivities, which are not significant and then set to 0."""
    noise = of_sensor("consumer")
    for size in (0.0, 3e-6, 1e-5, 2e-5, 5e-5):

        def draw(rng: np.random.Generator, size: float = size) -> tuple[Truth, Log]:
            truth = Truth.draw(rng)
            truth.G[:] = rng.normal(0, size, (3, 3))
            return truth, log(truth, noise, attitudes(14, rng), rng, latitude=LATITUDE)

        twice(f"G of {np.degrees(size * GRAVITY):.2g} deg/s/g", range(seed, seed + records), draw, noise)


def frames(records: int, seed: int) -> None:
    """Print coverage in each frame, for an accelerometer whose noise decides the directions."""
    noise = NoiseModel.parse("N=2e-2 + B=5e-3"), NoiseModel.parse("N=5e-5")

    def draw(rng: np.random.Generator) -> tuple[Truth, Log]:
        truth = Truth.draw(rng)
        truth.M_a[np.tril_indices(3, -1)] *= 3
        return truth, log(truth, noise, attitudes(14, rng), rng, latitude=LATITUDE)

    for frame in FRAMES:
        whole(
            f"frame {frame}",
            range(seed, seed + records),
            draw,
            lambda one, _, frame=frame: calibrate(  # type: ignore[misc]
                one.recording(), models_of(noise), LATITUDE, gravity=GRAVITY, frame=frame
            ),
        )


def held_out_rests(means: FloatArray, base: FloatArray, walk: FloatArray, gravity: float) -> FloatArray:
    """Return the studentised |f| - g of each rest by a fit without its fifth of the rests."""
    z = np.empty(len(means))
    for fold in range(5):
        out = np.arange(len(means)) % 5 == fold
        keep = np.ix_(~out, ~out)
        found: AccelerometerEstimate = estimate_accelerometer(
            means[~out], np.array([K[keep] for K in base]), walk[keep], gravity=gravity, checked=False
        )
        C = np.zeros((3, 3))
        C[LOWER] = found.theta[:6]
        norm, J, weights = derivatives(means[out], C, found.theta[6:])
        noise = np.array([np.diag(K)[out] for K in base]).T + found.excess.tau**2
        noise = noise + found.excess.kappa**2 * np.diag(walk)[out][:, None]
        variance = np.einsum("ij,jk,ik->i", J, found.covariance, J) + (weights**2 * noise).sum(axis=1)
        z[out] = (norm - gravity) / np.sqrt(variance)
    return z


def real() -> None:
    """Print gains, held-out coverage and published values of two logs."""
    path = real_data("..", "poses", "imu_tk_xsens_mti.csv.gz")
    recording = imucal.read(path, accel_scale=1.0, gyro_scale=1.0)
    found = calibrate(recording, gravity=9.81744)
    assert found.gyroscope is not None
    for result, gains in ((found.accelerometer, (415, 413, 415)), (found.gyroscope, (4778, 4758, 4766))):
        own = np.linalg.norm(result.M, axis=1)
        print(f"Xsens gains {own.round(1).tolist()}, off by {100 * np.abs(own / gains - 1).max():.2f} %")
    spans_s = np.array([(r.start_s, r.end_s) for r in found.rests if r.used])
    data = [triad(recording, s) for s in (Sensor.ACCELEROMETER, Sensor.GYROSCOPE)]
    assert data[0] is not None
    assert data[1] is not None
    rests = [RestMeans.of(d, spans_s) for d in data if d]
    n = len(data[0].samples)
    rate = data[0].rate_hz
    K_a, K_g = (
        np.array(
            [
                mean_covariance(white_model(float(s), rate), r.spans, rate_hz=rate, samples=n)
                for s in r.deviations
            ]
        )
        for r in rests
    )
    walk = walk_covariance(rests[0].spans, rate_hz=rate, samples=n)
    z = held_out_rests(rests[0].means, K_a, walk, 9.81744)
    print(f"Xsens held-out rests inside 95 %: {np.sum(np.abs(z) < 1.96)} of {z.size}")
    estimate = estimate_accelerometer(rests[0].means, K_a, walk, gravity=9.81744, checked=False)
    fit = estimate.fit
    rest = estimate_gyro_rest(
        rests[1].means, fit.f, K_g, walk,
        scale=found.gyroscope.M, earth=earth_rate(None), gravity=9.81744, checked=False,
    )  # fmt: skip
    f = (data[0].samples - fit.b) @ fit.C.T
    parts = f @ rest.G_apparent.T, fit.f @ rest.G_apparent.T
    arrays = prepare_turns(data[1], rests[1], fit.up, np.arange(len(spans_s) - 1), parts)
    models = tuple(
        NoiseModel.parse(f"{white_model(float(s), rate).text()} + K={float(e.kappa)!r}")
        for s, e in zip(rests[1].deviations, rest.excess, strict=True)
    )
    noise = GyroNoise(
        models=models, tau=np.array([e.tau for e in rest.excess]), rest_spans=rests[1].spans, samples=n
    )
    directions = direction_covariance(fit, rests[0].means, estimate.covariances)
    inside = []
    for fold in range(5):
        out = np.arange(len(arrays.rests)) % 5 == fold
        part: TurnsFit = fit_turns(arrays.keeping(~out), noise, directions)
        held = arrays.keeping(out)
        carried = _carry(held, part.C)
        S = _covariance(held, carried, noise, directions, part.C)
        # A misfit widens the noise of a turn like the parameters.
        S = S * part.widening**2 + carried.J @ part.covariance @ carried.J.T
        inside.append(np.abs(carried.residual.ravel()) < part.quantile * np.sqrt(np.diag(S)))
    print(
        f"Xsens held-out turns inside 95 %: {np.sum(np.concatenate(inside))} of {np.concatenate(inside).size}"
    )
    published = {"scale": (0.363, 0.315, 0.647), "bias": (0.103, 0.097, 0.344)}
    hand = calibrate(
        imucal.read(real_data("..", "poses", "mikoff_mpu9150_1.csv.gz"), rate_hz=100.0), gravity=9.81
    )
    for kind, values in published.items():
        for axis, value in zip(AXES, values, strict=True):
            p = hand.accelerometer.parameters[f"{kind}_{axis}"]
            assert p.low is not None
            assert p.high is not None
            where = "inside" if p.low < value < p.high else "outside"
            print(f"MPU-9150 {kind} {axis}: published {value}, {p.low:.3f} to {p.high:.3f} {p.unit}: {where}")


def main() -> None:
    """Print the parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--seed", type=int, default=2_000_000)
    parts = {
        "accelerometer": accelerometer, "gyroscope": gyroscope, "faults": faults, "fixture": fixture,
        "hand": hand, "gauss-markov": gauss_markov, "earth": earth, "warming": warming,
        "faces": faces, "fast": fast, "sensitivity": sensitivity, "frames": frames,
    }  # fmt: skip
    parser.add_argument("--only", nargs="*", default=[*parts, "real"])
    options = parser.parse_args()
    for name in options.only:
        try:
            if name == "real":
                real()
            else:
                parts[name](options.records, options.seed)
        except DataError as error:
            print(f"{name}: {error}")


if __name__ == "__main__":
    main()
