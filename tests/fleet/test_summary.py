"""Tests of the results of a fleet: odd units, logs that differ, and fleets with too few data."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import imucal
from imucal.errors import ChoiceError, DataError, ReadError, StoreError
from imucal.fitting.noise_fit import Estimate
from imucal.fleet.as_report import check_fleet, fleet_as_report
from imucal.fleet.page import verdict
from imucal.fleet.population import population
from imucal.fleet.store import RunFile
from imucal.fleet.summary import Fleet, FleetTerm, labels_to_type
from imucal.multiple_tests import holm
from imucal.report.exports import TARGETS, ExportOptions, render
from imucal.report.result import Report
from tests.fleet.simulated_store import SETTINGS, TERMS, asked, write_store
from tests.raising import raises


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Fleet:
    """Return a fleet of 24 units: u07 is odd, logs of u02 differ, five logs failed."""
    return imucal.load_fleet(write_store(tmp_path_factory.mktemp("fleets") / "fleet"))


@pytest.fixture(scope="module")
def median(fleet: Fleet) -> Report:
    """Return the median unit of the fleet."""
    return fleet_as_report(fleet, value="median")


def with_estimate(report: Report, key: str, change: Callable[[Estimate], Estimate]) -> Report:
    """Return the report with a changed term of its first axis."""
    axis, *others = report.axes
    estimates = tuple(change(e) if e.key == key else e for e in axis.fit.estimates)
    return replace(report, axes=(replace(axis, fit=replace(axis.fit, estimates=estimates)), *others))


def test_medians_cover_the_truth_and_only_the_odd_unit_is_sure(fleet: Fleet) -> None:
    """The limits of the median cover the truth in at least 14 of 18 terms."""
    model = fleet.model()
    held = [
        term.population.median.low
        <= TERMS[str(term.sensor), term.term][1] * math.exp(0.034)
        <= term.population.median.high
        for term in model.terms
    ]
    assert len(held) == 18
    assert sum(held) >= 14
    assert {(term.name, term.term): term.sure for term in model.terms if term.sure} == {
        ("gyro_z", "N"): ("u07",)
    }
    assert {(term.name, term.term): term.differing for term in model.terms if term.differing} == {
        ("gyro_x", "N"): ("u02",)
    }
    assert (len(model.units), model.rate_hz) == (24, 200.0)
    with pytest.raises(KeyError, match="gyro_x N"):
        model["gyro_x", "Q"]


def test_tests_are_adjusted_for_all_units_and_terms(fleet: Fleet) -> None:
    """Without this, one of 20 terms would have a false alarm."""
    terms = fleet.model().terms
    units = [(term, unit) for term in terms for unit in term.population.units]
    p_odd = holm([unit.p_value or 0.0 for _, unit in units])
    p_logs = holm([unit.p_logs or 0.0 for _, unit in units])
    assert len(units) == 24 * 18
    assert [unit.unit in term.sure for term, unit in units] == [p <= 0.05 for p in p_odd]
    assert [unit.unit in term.differing for term, unit in units] == [p <= 0.05 for p in p_logs]
    assert all({*term.sure} <= {unit.unit for unit in term.odd} for term in terms)
    assert sum(len(term.sure) for term in terms) > 0


def test_the_bound_without_odd_units_is_that_of_the_others(fleet: Fleet) -> None:
    term = fleet.model()["gyro_z", "N"]
    others = population([log for log in term.logs if log.unit != "u07"])
    assert term.without_odd == others.tolerance
    assert (term.without_odd or math.inf) < 0.8 * (term.population.tolerance or 0.0)
    assert fleet.model()["gyro_x", "K"].without_odd is None


def test_logs_that_do_not_count_are_grouped(fleet: Fleet) -> None:
    """The most frequent reason comes first; a log that was moved is one of them."""
    assert [(kind, len(logs)) for (kind, _), logs in fleet.failures.items()] == [
        ("unreadable", 2),
        ("memory", 1),
        ("not-noise", 1),
        ("timeout", 1),
    ]
    assert ("unreadable", "the file is damaged: no footer after byte 12") in fleet.failures
    assert "u94" not in fleet.model().units
    grade, text = verdict(fleet)
    assert grade == "check"
    assert text.startswith("Odd unit u07 (gyro_z N); 5 of 101 logs do not count; ")
    *others, last = fleet.logs
    one = replace(fleet, logs=(*(replace(log, left_out="") for log in others), last))
    assert "; 1 of 101 logs does not count" in verdict(one)[1]


def test_a_copy_of_a_log_is_not_requested_twice(tmp_path: Path) -> None:
    """It is done with its original; another log without results is unfinished."""
    write_store(tmp_path, units=3, temperatures=(25.0,), special=False, failures=False, names=("gyro_x",))
    first = imucal.load_fleet(tmp_path).logs[0].path
    with RunFile(tmp_path, SETTINGS, [asked("copy.mcap", copy_of=first), asked("late.mcap")]):
        pass
    fleet = imucal.load_fleet(tmp_path)
    assert (fleet.asked, len(fleet.logs)) == (4, 3)


def test_folders_without_finished_logs_are_rejected(tmp_path: Path) -> None:
    """A damaged store is rejected too, with the place of the damage."""
    with pytest.raises(ReadError, match="no fleet in this folder; expected the folder of a fleet"):
        imucal.load_fleet(tmp_path)
    with RunFile(tmp_path, SETTINGS, [asked("a.csv")]) as file:
        pass
    with pytest.raises(DataError, match="found 1 logs, none finished"):
        imucal.load_fleet(tmp_path)
    with file.path.open("ab") as stream:
        stream.write(b'00000000 {"log": {}}\n')
    with pytest.raises(StoreError, match=rf"{file.path.name}:2: is damaged, and does not count"):
        imucal.load_fleet(tmp_path)


def test_logs_without_a_unit_are_in_no_population(tmp_path: Path) -> None:
    write_store(tmp_path / "loose", units=3, labelled=False, failures=False, names=("gyro_x",))
    fleet = imucal.load_fleet(tmp_path / "loose")
    assert fleet.models == ()
    assert fleet.loose == fleet.logs
    assert fleet.labels == "{unit}.mcap"
    assert verdict(fleet) == ("check", "12 logs have no unit label.")
    with raises(ChoiceError, "no log has a unit label", place="loose", argument="model"):
        fleet.model()


@pytest.mark.parametrize(
    ("paths", "text"),
    [
        (["a/u1/x.bag", "a/u2/x.bag"], "{unit}/*.bag"),
        (["a/u1/x.bag", "a/u2/y.mcap"], "{unit}/*"),
        (["u1.csv", "u2.csv"], "{unit}.csv"),
        (["logs/u1.csv", "logs/u2.csv"], "{unit}.csv"),
        (["a\\u1\\x.bag", "a\\u2\\x.bag"], "{unit}/*.bag"),
    ],
)
def test_suggested_labels_use_the_differing_part_of_the_path(paths: list[str], text: str) -> None:
    """It is the folder if folders differ, otherwise the file name."""
    assert labels_to_type(paths) == text


def test_a_model_is_selected_by_name(fleet: Fleet) -> None:
    """The error for an unknown name lists the models, and so does that for a missing name."""
    assert fleet.model("ACME-6") is fleet.model()
    with raises(ChoiceError, "'BOLT-9'", place="fleet", argument="model"):
        fleet_as_report(fleet, "BOLT-9")
    both = replace(fleet, models=(fleet.model(), replace(fleet.model(), name="BOLT-9")))
    with raises(ChoiceError, "'ACME-6', 'BOLT-9'", place="fleet", argument="model"):
        both.model()


def test_two_units_have_neither_spread_nor_bound(tmp_path: Path) -> None:
    """Export and check explain it; the median is exported."""
    write_store(tmp_path, units=2, failures=False, special=False, weak="", names=("gyro_x",))
    fleet = imucal.load_fleet(tmp_path)
    found = fleet.model().terms[0].population
    assert (found.spread, found.tolerance) == (None, None)
    few, changing = verdict(fleet)[1].split("; changes from log to log: ")
    assert few == "ACME-6: too few units for a spread or a bound"
    assert changing == "u00 (gyro_x N); u01 (gyro_x N)."
    with pytest.raises(DataError, match=r"2 units, .* a tolerance bound"):
        fleet_as_report(fleet)
    report = fleet_as_report(fleet, value="median")
    assert report.axes[0].fit["N"].value == found.median.value
    with pytest.raises(DataError, match=r"2 units of ACME-6, .* to predict"):
        check_fleet(report, fleet)


def test_exports_contain_the_tolerance_bound(fleet: Fleet) -> None:
    """A comment explains its origin, and every format can be written."""
    report = fleet_as_report(fleet)
    text = render(report, "kalibr", ExportOptions(numbers="as-fitted"))
    worst = max(fleet.model()[f"gyro_{a}", "N"].population.tolerance or 0.0 for a in "xyz")
    assert f"gyroscope_noise_density: {worst:.8g}" in text
    assert "fleet of 24 units of ACME-6; every number is the 95/95 tolerance bound" in text
    assert "enough for gyro_x, gyro_y, gyro_z, 95/95 tolerance bound of 24 units" in render(report, "kalibr")
    for target in TARGETS:
        assert "written by imucal" in render(report, target)
    with pytest.raises(ValueError, match="is not one of tolerance, median"):
        fleet_as_report(fleet, value="mean")  # type: ignore[arg-type]


def test_an_undetected_term_is_a_bound_in_exports(tmp_path: Path) -> None:
    """That of the median is only bounded; the number for the config is the tolerance bound."""
    write_store(
        tmp_path, units=4, temperatures=(25.0,), special=False, failures=False, weak="", absent="y",
        names=("gyro_x", "gyro_y"),
    )  # fmt: skip
    fleet = imucal.load_fleet(tmp_path)
    found = fleet.model()["gyro_y", "K"].population
    assert found.bounded
    assert [unit.p_logs for unit in found.units] == [None] * 4
    estimate = fleet_as_report(fleet, value="median")["gyro_y"]["K"]
    assert (estimate.status, estimate.high) == ("bounded", found.median.high)
    assert fleet_as_report(fleet)["gyro_y"]["K"].value == found.tolerance


def test_gauss_markov_terms_are_exported_with_the_time_of_the_median_log(tmp_path: Path) -> None:
    """Formats without Gauss-Markov terms list them in a comment."""
    write_store(
        tmp_path, units=5, special=False, failures=False, weak="", times=(40.0, 100.0, 250.0),
        names=("gyro_x", "gyro_y"),
    )  # fmt: skip
    fleet = imucal.load_fleet(tmp_path)
    report = fleet_as_report(fleet)
    found = report["gyro_x"]["GM"]
    assert found.value == fleet.model()["gyro_x", "GM"].population.tolerance
    assert found.correlation_time is not None
    assert found.correlation_time.value == pytest.approx(100, rel=1e-6)
    assert [axis.name for axis in report.axes if "GM" in str(axis.fit.model)] == ["gyro_x"]
    states = render(report, "gm")
    assert f"{found.value:.8g}" in states
    assert "100" in states
    assert "GM (gyro_x)" in render(report, "kalibr", ExportOptions(numbers="as-fitted"))


def test_a_typical_unit_passes_and_a_noisy_unit_fails(fleet: Fleet, median: Report) -> None:
    """The text contains the range of the next unit."""
    rows = check_fleet(median, fleet)
    assert [row.verdict for row in rows] == ["pass"] * 18
    swapped = replace(median, axes=(median["gyro_y"], *median.axes[2:]))
    wrong = with_estimate(
        swapped, "N", lambda e: replace(e, value=2 * (e.value or 0), low=2 * e.low, high=2 * e.high)
    )
    failed = [row for row in check_fleet(wrong, fleet) if row.verdict == "fail"]
    assert [(row.where, row.subject[:4]) for row in failed] == [("gyro_y", "N in")]
    assert "unlike the units of the fleet" in failed[0].text
    assert "the next unit of ACME-6 is in [" in failed[0].text
    with pytest.raises(DataError, match="no axis and term in common with ACME-6"):
        check_fleet(replace(median, axes=()), fleet)


def test_an_interval_beyond_the_range_is_undecided(fleet: Fleet, median: Report) -> None:
    """Wide intervals and high upper bounds are undecided."""
    only_y = replace(median, axes=(median["gyro_y"],))
    low, high = fleet.model()["gyro_y", "N"].population.prediction or (0.0, 0.0)
    middle = math.sqrt(low * high)

    def verdict_of(value: float | None, least: float, most: float) -> str:
        one = with_estimate(
            only_y,
            "N",
            lambda e: (
                replace(e, value=value, low=least, high=most) if value else Estimate.bounded("N", "N", most)
            ),
        )
        (row,) = [row for row in check_fleet(one, fleet) if row.subject.startswith("N ")]
        assert row.text.endswith("record for longer to decide") == (row.verdict == "undecided")
        return row.verdict

    assert verdict_of(middle, 1.01 * low, 0.99 * high) == "pass"
    assert verdict_of(middle, 1.01 * low, 1.5 * high) == "undecided"
    assert verdict_of(middle, 0.5 * low, 0.9 * high) == "undecided"
    assert verdict_of(None, 0.0, 2 * high) == "undecided"


def test_a_term_of_few_units_is_undecided(fleet: Fleet, median: Report) -> None:
    """Terms of all units are still judged."""
    (model,) = fleet.models

    def of_two(term: FleetTerm) -> FleetTerm:
        if term.name != "accel_x":
            return term
        logs = tuple(log for log in term.logs if log.unit in {"u01", "u02"})
        return replace(term, logs=logs, population=population(logs))

    few = replace(fleet, models=(replace(model, terms=tuple(map(of_two, model.terms))),))
    rows = check_fleet(median, few)
    assert [row.verdict for row in rows if row.where == "accel_x"] == ["undecided"] * 3
    assert {row.verdict for row in rows if row.where != "accel_x"} == {"pass"}
    text = next(row.text for row in rows if row.where == "accel_x" and row.subject == "N")
    assert text.endswith(
        "2 units of the fleet with it, expected at least 3 to predict the next unit: not judged"
    )
