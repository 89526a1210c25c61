"""Several logs of one unit: have they one coefficient? Asked of the bins that the store keeps."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import TypeAlias

from imucal.errors import DataError
from imucal.findings import Finding
from imucal.fitting.bins import unpack
from imucal.fleet.pooling import PooledFit, pool_bins
from imucal.fleet.store import FleetStore
from imucal.fleet_report.summary import FleetLog, UnitLogs
from imucal.noise.terms import TERMS
from imucal.recording import Sensor
from imucal.side_work import try_side_work

#: Model, sensor, axis and term.
TermKey: TypeAlias = tuple[str, str, str, str]
#: Relative difference of two sampling rates that is none.
_SAME_RATE = 1e-3
_LEVEL = 0.95
#: So many logs' bins are held at once, 18 kB each.
_AT_ONCE = 5000


def unit_tests(
    store: FleetStore, logs: Mapping[str, FleetLog], terms: Collection[TermKey]
) -> tuple[dict[TermKey, tuple[UnitLogs, ...]], tuple[Finding, ...]]:
    """Return for each term the units with several logs, and what could not be judged.

    Parameters
    ----------
    store
        Of the fleet.
    logs
        By key.
    terms
        Those that each model's axes have.
    """
    found: dict[TermKey, list[UnitLogs]] = {}
    findings: list[Finding] = []
    for (model, sensor, axis, unit), every in _packed(store, logs):
        keys = [key for key in terms if key[:3] == (model, sensor, axis)]
        symbols = tuple(symbol for symbol in TERMS if symbol in {_symbol(key[3]) for key in keys})
        where = f"{Sensor(sensor).short}_{axis}"
        pooled, said = try_side_work(
            lambda every=every, symbols=symbols, sensor=sensor: _pooled(every, symbols, Sensor(sensor)),  # type: ignore[misc]
            None,
            what=f"{unit}: whether its logs agree in {where} is not known",
            code="not-checked",
            axis=where,
        )
        findings += said
        for key in keys if pooled else ():
            own = _of_term(pooled, key[3], unit) if pooled else None
            if own:
                found.setdefault(key, []).append(own)
    return {key: tuple(tests) for key, tests in found.items()}, tuple(findings)


def _packed(
    store: FleetStore, logs: Mapping[str, FleetLog]
) -> Iterator[tuple[tuple[str, str, str, str], list[bytes]]]:
    """Yield the packed bins of units with several logs, by model, sensor, axis and unit."""
    keys: dict[tuple[str, str], list[str]] = {}
    for key, log in logs.items():
        if log.unit is not None and not log.left_out:
            keys.setdefault((log.model, log.unit), []).append(key)
    several = [own for _, own in sorted(keys.items()) if len(own) > 1]
    for frame in store.bins_in_turn(_together(several)) if several else ():
        found: dict[tuple[str, str, str, str], list[bytes]] = {}
        for row in frame.iter_rows(named=True):
            log = logs[row["key"]]
            if row["bins"] is not None:
                place = (log.model, row["sensor"], row["axis"], log.unit or "")
                found.setdefault(place, []).append(row["bins"])
        yield from ((place, every) for place, every in sorted(found.items()) if len(every) > 1)


def _together(units: Iterable[Sequence[str]]) -> Iterator[list[str]]:
    """Yield the keys of some units at a time, whose bins are read at once."""
    keys: list[str] = []
    for own in units:
        keys += own
        if len(keys) >= _AT_ONCE:
            yield keys
            keys = []
    if keys:
        yield keys


def _pooled(packed: Sequence[bytes], symbols: tuple[str, ...], sensor: Sensor) -> PooledFit:
    every = [unpack(data) for data in packed]
    first = every[0].tau0
    rates = sorted({f"{1 / one.tau0:.6g} Hz" for one in every if abs(one.tau0 / first - 1) > _SAME_RATE})
    if rates:
        msg = f"found rates of {1 / first:.6g} Hz and {', '.join(rates)}, expected one"
        raise DataError(msg)
    return pool_bins(every, symbols, sensor=sensor, rate_hz=1 / first, level=_LEVEL)


def _of_term(pooled: PooledFit, term: str, unit: str) -> UnitLogs | None:
    test = next((test for test in pooled.homogeneity if test.key == term), None)
    if test is None:
        return None
    joint = pooled[term]
    return UnitLogs(
        unit=unit,
        logs=pooled.records,
        p_value=test.p_value,
        differs=test.differs,
        spread=test.spread,
        value=joint.value,
        low=joint.low,
        high=joint.high,
    )


def _symbol(term: str) -> str:
    return term.rstrip("0123456789")
