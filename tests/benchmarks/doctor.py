"""How often `imucal.doctor` is right: signed orders of axes, damages, clean logs, delays, and its speed.

    python -m tests.benchmarks.doctor [--records N] [--seed S] [--only PART...]

Parts: orders (BROAD logs and simulated ones), damages, clean, delay, speed.
"""

import argparse
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import h5py
import numpy as np

from imucal.health import Diagnosis, Row, diagnose
from imucal.health.axes import ORDERS
from tests.health.simulated import GRAVITY, Imu, Samples, sampled, swaying, turns_and_rests, walking
from tests.real_data import real_data

#: Logs with optical truth: slow rotation, fast rotation, slow translation, and rotation with taps.
BROAD = ("broad_05*", "broad_09*", "broad_14*", "broad_24*")
#: Noise in SI per sqrt(Hz) of gyroscopes and accelerometers.
NOISE = ((5e-5, 8e-4), (1.5e-4, 2e-3), (3e-4, 4e-3))
RATES = (50.0, 100.0, 200.0, 400.0, 500.0)


def row_of(diagnosis: Diagnosis, code: str) -> Row:
    return next(row for row in diagnosis.rows if row.code == code)


def mapping(order: np.ndarray) -> str:
    """Return an order of axes as the row of the axes does."""
    names = [f"{'-' if row[k] < 0 else ''}{'xyz'[k]}" for row in order for k in [int(np.abs(row).argmax())]]
    return " ".join(f"{axis}={name}" for axis, name in zip("xyz", names, strict=True))


def broad(pattern: str) -> Samples:
    path = next(iter(sorted((real_data() / "motion").glob(pattern))))
    with h5py.File(path) as file:
        rate = float(file.attrs["sampling_rate"])
        return Samples(gyroscope=file["imu_gyr"][:], accelerometer=file["imu_acc"][:], rate_hz=rate)


def drawn_imu(rng: np.random.Generator) -> Imu:
    noise_g, noise_a = NOISE[rng.integers(len(NOISE))]
    return Imu(rate_hz=float(rng.choice(RATES)), noise_g=noise_g, noise_a=noise_a)


def orders(records: int, seed: int) -> None:
    print("orders: log, wrong, told of 48")
    for pattern in BROAD:
        samples = broad(pattern)
        wrong, told = order_counts(samples)
        print(f"  {pattern:12s} {wrong:3d} {told:3d}")
    for turns in (3, 4, 6, 12):
        wrong = told = 0
        for k in range(records):
            rng = np.random.default_rng([seed, turns, k])
            samples = sampled(turns_and_rests(rng, turns=turns), rng, drawn_imu(rng))
            order = ORDERS[rng.integers(48)]
            row = row_of(diagnose(samples.mapped(order).recording()), "axes")
            right = row.values.get("mapping") == mapping(order)
            told += right
            wrong += row.values.get("mapping") is not None and not right
            wrong += np.array_equal(order, np.eye(3)) and row.status == "fail"
        print(f"  {turns:2d} turns simulated: {wrong} wrong, {told / records:.1%} told of {records}")


def order_counts(samples: Samples) -> tuple[int, int]:
    wrong = told = 0
    for order in ORDERS:
        row = row_of(diagnose(samples.mapped(order).recording()), "axes")
        said = row.values.get("mapping")
        told += said == mapping(order)
        wrong += said not in {None, mapping(order)}
        wrong += row.status == "pass" and not np.array_equal(order, np.eye(3))
    return wrong, told


Damage = tuple[str, str, Callable[[Samples], Samples]]


def damages() -> Iterator[Damage]:
    """Yield the name, the code of the row that must not pass, and the damage."""

    def gyro(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Samples], Samples]:
        return lambda s: replace(s, gyroscope=change(s.gyroscope))

    def accel(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Samples], Samples]:
        return lambda s: replace(s, accelerometer=change(s.accelerometer))

    def column(k: int, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        def changed(x: np.ndarray) -> np.ndarray:
            x = x.copy()
            x[:, k] = change(x[:, k])
            return x

        return changed

    for name, factor in (
        ("x 57.3", 57.2958),
        ("/ 57.3", 1 / 57.2958),
        ("x 1000", 1e3),
        ("x 131 x 57.3", 7506.0),
    ):
        yield f"gyro {name}", "gyroscope-unit", gyro(partial(np.multiply, factor))
    yield "gyro x 2", "gyroscope-unit", gyro(lambda x: 2 * x)
    yield "gyro / 2", "gyroscope-unit", gyro(lambda x: x / 2)
    for name, factor in (
        ("/ 9.8", 1 / GRAVITY),
        ("x 1000 / 9.8", 1e3 / GRAVITY),
        ("x 1000", 1e3),
        ("x 9.8", GRAVITY),
    ):
        yield f"accel {name}", "accelerometer-unit", accel(partial(np.multiply, factor))
    yield "accel / 2", "accelerometer-unit", accel(lambda x: x / 2)
    for k in range(3):
        yield f"gyro {'xyz'[k]} flipped", "axes", gyro(column(k, lambda x: -x))
    yield "gyro flipped", "axes", gyro(lambda x: -x)
    yield "gyro x, y swapped", "axes", gyro(lambda x: x[:, [1, 0, 2]])
    yield "gyro cycled", "axes", gyro(lambda x: x[:, [1, 2, 0]])
    yield "accel y flipped", "axes", accel(column(1, lambda x: -x))
    yield "accel y, z swapped", "axes", accel(lambda x: x[:, [0, 2, 1]])
    yield "accel x, y turned", "axes", accel(lambda x: x[:, [1, 0, 2]] * [1, -1, 1])
    yield "accel inverted", "up", accel(lambda x: -x)
    yield (
        "gyro clipped at 60 deg/s",
        "saturated",
        gyro(lambda x: np.clip(x, -math.radians(60), math.radians(60))),
    )
    yield "gyro z clipped", "saturated", gyro(column(2, lambda x: np.clip(x, 0.5 * x.min(), 0.5 * x.max())))
    yield "accel x clipped", "saturated", accel(column(0, lambda x: np.clip(x, 0.7 * x.min(), 0.7 * x.max())))
    yield "gravity removed", "no-gravity", lambda s: replace(s, accelerometer=without_gravity(s))
    yield "gravity removed, g", "no-gravity", lambda s: replace(s, accelerometer=without_gravity(s) / GRAVITY)
    yield "gyro y stuck for 3 s", "stuck", gyro(column(1, stuck))
    yield "accel z stuck for 3 s", "stuck", accel(column(2, stuck))
    yield "gyro x always 0", "axis-missing", gyro(column(0, np.zeros_like))
    yield "accel z constant", "axis-missing", accel(column(2, lambda x: np.full_like(x, 9.8)))
    yield "gyro held", "held-samples", gyro(held)
    yield "accel held", "held-samples", accel(held)
    yield "gyro interpolated", "interpolated-samples", gyro(interpolated)
    yield "accel interpolated", "interpolated-samples", accel(interpolated)
    yield "gyro x spikes", "spikes", gyro(column(0, spiked))
    yield "accel y spikes", "spikes", accel(column(1, spiked))
    yield "gyro y is x", "duplicate-axes", gyro(lambda x: x[:, [0, 0, 2]])
    yield "accel z is -y", "duplicate-axes", accel(lambda x: x[:, [0, 1, 1]] * [1, 1, -1])
    yield (
        "swapped sensors",
        "accelerometer-unit",
        lambda s: replace(s, gyroscope=s.accelerometer, accelerometer=s.gyroscope),
    )


def without_gravity(samples: Samples) -> np.ndarray:
    """Return the linear acceleration of a driver that knows the attitude: what is left of its length."""
    f = samples.accelerometer
    length = np.linalg.norm(f, axis=1, keepdims=True)
    return np.asarray(f * (1 - GRAVITY / length))


def stuck(x: np.ndarray) -> np.ndarray:
    """Return an axis with one value around its fastest moment."""
    x, n = x.copy(), len(x)
    middle, half = int(np.abs(np.diff(x)).argmax()), n // 30
    x[max(middle - half, 0) : middle + half] = x[max(middle - half, 0)]
    return x


def held(x: np.ndarray) -> np.ndarray:
    """Return samples of which every second repeats the one before."""
    return x[np.arange(len(x)) // 2 * 2]


def interpolated(x: np.ndarray) -> np.ndarray:
    """Return samples of which every fourth is the mean of its neighbours."""
    x = x.copy()
    x[2:-1:4] = (x[1:-2:4] + x[3::4][: len(x[1:-2:4])]) / 2
    return x


def spiked(x: np.ndarray) -> np.ndarray:
    x = x.copy()
    x[100 :: len(x) // 12] += 5 * x.std()
    return x


def damage_logs(seed: int) -> None:
    print("damages: passed rows (must be none)")
    passed, told = [], Counter[str]()
    for k, (name, code, damage) in enumerate(damages()):
        rng = np.random.default_rng([seed, 77, k])
        imu = replace(drawn_imu(rng), rate_hz=float(rng.choice([100.0, 200.0, 400.0])))
        row = row_of(
            diagnose(damage(sampled(turns_and_rests(rng), rng, imu)).recording(), expect="z-up"), code
        )
        told[row.status] += 1
        if row.status != "fail":
            print(f"  {row.status}: {name}: {row.found}")
        if row.status == "pass":
            passed.append(name)
    for k, delay_ms in enumerate((3, -5, 8, 12, -20, 30)):
        rng = np.random.default_rng([seed, 78, k])
        motion = turns_and_rests(rng, lever_m=0.02, carried_m=0.0)
        log = sampled(motion, rng, Imu(rate_hz=285.0), delay_s=delay_ms / 1e3)
        row = row_of(diagnose(log.recording()), "sensor-delay")
        told[row.status] += 1
        if row.status not in {"fail", "warn"}:
            print(f"  {row.status}: delay {delay_ms} ms: {row.found}")
        if row.status == "pass":
            passed.append(f"delay {delay_ms} ms")
    print(f"  {sum(told.values())} damages: {dict(told)}; passed: {passed or 'none'}")


def clean_logs(records: int, seed: int) -> None:
    print("clean: logs with a row that fails or warns (fails must be at most 1 %)")
    counts, causes = Counter[str](), Counter[str]()
    for k in range(records):
        rng = np.random.default_rng([seed, 5, k])
        kind = ("turns", "carried", "sway", "walk", "hover")[k % 5]
        diagnosis = diagnose(clean(kind, rng).recording())
        counts[f"{kind} {diagnosis.status}"] += 1
        for row in diagnosis.rows:
            if row.status in {"fail", "warn"}:
                causes[f"{kind} {row.status} {row.code}"] += 1
    print(f"  {dict(sorted(counts.items()))}")
    print(f"  {dict(causes)}")


def clean(kind: str, rng: np.random.Generator) -> Samples:
    """Return a clean log of a kind of motion."""
    imu = drawn_imu(rng)
    match kind:
        case "turns":
            return sampled(turns_and_rests(rng, turns=int(rng.integers(3, 13))), rng, imu)
        case "carried":
            return sampled(turns_and_rests(rng, lever_m=0.2, carried_m=0.3), rng, imu)
        case "sway":
            return sampled(swaying(rng), rng, imu)
        case "walk":
            return sampled(walking(rng), rng, imu)
    motion = swaying(rng, sway=0.15, carried_m=0.1, carried_hz=(0.1, 0.5))
    return sampled(motion, rng, imu, vibration=(rng.uniform(0.02, 0.2), rng.uniform(0.5, 4.0)))


def delays(records: int, seed: int) -> None:
    print("delay: lever and carried distance in m, coverage of 95 %, rms error, median half width in ms")
    for lever, carried in ((0.0, 0.0), (0.03, 0.0), (0.1, 0.1)):
        errors, halves = [], []
        for k in range(records):
            rng = np.random.default_rng([seed, 9, k])
            motion = turns_and_rests(rng, turns=15, lever_m=lever, carried_m=carried)
            delay = rng.uniform(-0.03, 0.03)
            row = row_of(
                diagnose(sampled(motion, rng, drawn_imu(rng), delay_s=delay).recording()), "sensor-delay"
            )
            if "delay_s" in row.values:
                errors.append(float(row.values["delay_s"] or 0) - delay)
                halves.append(float(row.values["high_s"] or 0) - float(row.values["delay_s"] or 0))
        error, half = np.array(errors) * 1e3, np.array(halves) * 1e3
        covered = float((np.abs(error) <= half).mean())
        rms = float(np.sqrt((error**2).mean()))
        print(
            f"  {lever:4.2f} {carried:4.2f}: {covered:.1%} of {len(error)}, rms {rms:.2f}, "
            f"median {np.median(np.abs(error)):.2f}, half width {np.median(half):.2f}"
        )


def speed(seed: int) -> None:
    print("speed: s for a log")
    for name, minutes, rate in (("10 min at 200 Hz", 10, 200.0), ("1 h at 1 kHz", 60, 1000.0)):
        rng = np.random.default_rng(seed)
        motion = swaying(rng, duration_s=60.0)
        one = sampled(motion, rng, Imu(rate_hz=rate))
        whole = replace(
            one,
            gyroscope=np.tile(one.gyroscope, (minutes, 1)),
            accelerometer=np.tile(one.accelerometer, (minutes, 1)),
        )
        recording = whole.recording()
        start = time.perf_counter()
        diagnose(recording)
        print(f"  {name}: {time.perf_counter() - start:.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=200)
    parser.add_argument("--seed", type=int, default=20260801)
    parser.add_argument("--only", nargs="*", default=["orders", "damages", "clean", "delay", "speed"])
    options = parser.parse_args()
    parts: dict[str, Callable[[], None]] = {
        "orders": lambda: orders(options.records, options.seed),
        "damages": lambda: damage_logs(options.seed),
        "clean": lambda: clean_logs(options.records, options.seed),
        "delay": lambda: delays(options.records, options.seed),
        "speed": lambda: speed(options.seed),
    }
    for name in options.only:
        parts[name]()


if __name__ == "__main__":
    main()
