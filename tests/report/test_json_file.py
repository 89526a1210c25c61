"""report.json: its schema, its golden file, reading it back, and errors for invalid files."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import numpy.testing as npt
import pytest

import imucal
from imucal.errors import Fix, ReadError
from imucal.findings import Finding
from imucal.pipeline import Settings, characterize
from imucal.recording import LogFileInfo, Source
from imucal.report.json_file import axis_document, from_document, load, schema, signal_document, to_document
from imucal.report.result import Report
from imucal.report.typed_json import dumps, to_json
from tests.benchmarks.report_schema import report_schema
from tests.report.random_reports import random_report
from tests.report.synthetic import consumer_report, shortest_report, small_report

_GOLDEN = Path(__file__).parent / "golden" / "report.json"


@pytest.mark.parametrize("make", [consumer_report, small_report, lambda: shortest_report(4)])
def test_documents_are_valid_by_the_schema(make: Callable[[], Report]) -> None:
    """Documents are those of the report and of each axis. The schema itself is valid too."""
    report = make()
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(schema())
    validator.validate(to_document(report))
    for axis in report.axes:
        validator.validate(axis_document(report, axis))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("axes", 0, "fit", "terms", "N", "status"), "guessed"),
        (("axes", 0, "fit", "terms", "N", "value"), None),
        (("axes", 0, "sensor"), "magnetometer"),
        (("schema",), "imucal/report/1"),
    ],
)
def test_the_schema_refuses_wrong_documents(place: tuple[Any, ...], value: object) -> None:
    """A schema that accepts everything would prove nothing."""
    document: Any = to_document(consumer_report())
    _set(document, place, value)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.Draft202012Validator(schema()).validate(document)


def test_the_schema_file_is_current() -> None:
    """Run `python -m tests.benchmarks.report_schema` after a change of the dataclasses."""
    assert schema() == report_schema()


def _strict(part: object) -> Any:  # noqa: ANN401 - JSON
    """Return a schema that allows only the listed keys in objects that list keys."""
    if isinstance(part, list):
        return [_strict(one) for one in part]
    if not isinstance(part, dict):
        return part
    found = {key: _strict(value) for key, value in part.items()}
    if isinstance(part.get("properties"), dict) and "type" in part:
        # Keys of the alternatives in `oneOf` count too.
        found["unevaluatedProperties"] = False
    return found


def _names(value: object) -> set[str]:
    """Return all keys in a document."""
    if isinstance(value, list):
        return {name for one in value for name in _names(one)}
    return set(value).union(*map(_names, value.values())) if isinstance(value, dict) else set()


def _listed(part: object) -> set[str]:
    """Return all keys that a schema lists."""
    if isinstance(part, list):
        return {name for one in part for name in _listed(one)}
    if not isinstance(part, dict):
        return set()
    own = part.get("properties")
    return (set(own) if isinstance(own, dict) else set()).union(*map(_listed, part.values()))


def _fitted_report() -> Report:
    """Return the report of a fit with segments, a remote log and its range."""
    samples = imucal.NoiseModel.parse("N=1e-4 + K=1e-5").simulate(
        40_000, rate_hz=50.0, rng=np.random.default_rng(5)
    )
    series = imucal.AxisSeries.from_samples(samples, rate_hz=50.0)
    file = LogFileInfo(path="s3://bucket/log.csv", size_bytes=5, blake2b="ab" * 64, etag="cd")
    source = Source(path="log.csv", format="csv", files=(file,))
    settings = Settings(model="N + K")
    return characterize(imucal.Recording(source=source, series=(series,)), settings)


def _report_with_fix() -> Report:
    """Return a report with a finding about a unit."""
    fix = Fix("", "gyro_unit", "deg/s")
    return replace(small_report(), findings=(Finding("warning", "unit-suspect", "Odd.", fix=fix),))


def test_the_fix_of_a_finding_is_read_back() -> None:
    """Commands that load a report name the same option."""
    report = _report_with_fix()
    assert from_document(json.loads(dumps(to_document(report)))).findings == report.findings


def test_the_writer_and_the_schema_have_the_same_keys() -> None:
    """Each written key is in the schema and in docs/json.md, and each key of the schema is written."""
    makers = (consumer_report, small_report, _fitted_report, _report_with_fix)
    documents = [to_document(make()) for make in makers]
    strict = jsonschema.Draft202012Validator(_strict(schema()))
    for document in documents:
        strict.validate(document)
        with pytest.raises(jsonschema.ValidationError):
            strict.validate({**document, "more": 1})
    assert _listed(schema()) - set().union(*map(_names, documents)) == set()


def test_the_document_equals_the_golden_file(*, update_golden: bool) -> None:
    """Names, order and numbers of report.json are stable; renew the file with --update-golden."""
    text = dumps(to_document(small_report()))
    if update_golden:
        _GOLDEN.parent.mkdir(exist_ok=True)
        _GOLDEN.write_text(text, encoding="utf-8")
    golden = json.loads(_GOLDEN.read_text(encoding="utf-8"))
    found = json.loads(text)
    assert _skeleton(found) == _skeleton(golden)
    # Special functions differ in their last digits between versions of SciPy.
    npt.assert_allclose(_numbers(found), _numbers(golden), rtol=1e-9)


@pytest.mark.parametrize("make", [consumer_report, small_report, lambda: shortest_report(4)])
def test_a_report_is_read_back_exactly(make: Callable[[], Report]) -> None:
    """Reading and writing again does not change a byte of the file."""
    report = make()
    text = dumps(to_document(report))
    again = from_document(json.loads(text))
    assert dumps(to_document(again)) == text
    for axis, original in zip(again.axes, report.axes, strict=True):
        assert axis.fit.model == original.fit.model
        assert axis.fit.estimates == original.fit.estimates
        assert repr(axis.fit.goodness) == repr(original.fit.goodness)
        assert (axis.gaps, axis.findings) == (original.gaps, original.findings)
        npt.assert_array_equal(axis.fit.covariance, original.fit.covariance)
        npt.assert_array_equal(axis.fit.used, original.fit.used)
        npt.assert_allclose(axis.spectrum.psd, original.spectrum.psd, rtol=1e-7)
        npt.assert_allclose(axis.fit.curve.avar, original.fit.curve.avar, rtol=1e-15)
    assert (again.source, again.findings, again.version) == (report.source, report.findings, report.version)
    assert dict(again.settings) == dict(report.settings)


@pytest.mark.parametrize("seed", range(10))
def test_random_reports_are_valid_and_read_back(seed: int) -> None:
    """Terms are estimated, bounded or absent; limits may be infinite."""
    report = random_report(np.random.default_rng(seed))
    text = dumps(to_document(report))
    jsonschema.validate(json.loads(text), schema())
    again = from_document(json.loads(text))
    assert dumps(to_document(again)) == text
    for axis, original in zip(again.axes, report.axes, strict=True):
        assert axis.fit.estimates == original.fit.estimates
        assert axis.fit.model == original.fit.model


def test_segments_are_read_back() -> None:
    """A term's homogeneity, the trace of white noise, and the range of the log are equal."""
    report = _fitted_report()
    again = from_document(json.loads(dumps(to_document(report))))
    segments, original = again.axes[0].fit.segments, report.axes[0].fit.segments
    assert segments is not None
    assert original is not None
    assert segments.terms == original.terms
    assert segments.white is not None
    assert original.white is not None
    npt.assert_array_equal(segments.white.high, original.white.high)
    assert again.source == report.source


def test_alternatives_of_a_term_are_read_back() -> None:
    """Alternatives are other terms, the horizon, and the widening of the interval. Older files have none."""
    report = small_report()
    axis = report.axes[0]
    doubtful = tuple(
        replace(e, alternatives=("GM", "K"), horizon_s=60.0, widening=1.5) for e in axis.fit.estimates
    )
    document = to_document(replace(report, axes=(replace(axis, fit=replace(axis.fit, estimates=doubtful)),)))
    assert from_document(document).axes[0].fit.estimates == doubtful
    document = json.loads(dumps(document))
    for term in document["axes"][0]["fit"]["terms"].values():
        del term["alternatives"], term["horizon_s"], term["widening"]
    plain = from_document(document).axes[0].fit.estimates
    assert {(e.alternatives, e.horizon_s, e.widening) for e in plain} == {((), math.inf, 1.0)}


def test_unknown_numbers_are_null_and_read_back() -> None:
    """The file contains no NaN or infinity; an unknown bound is read back as infinite."""
    report = small_report()
    axis = report.axes[0]
    curve = replace(axis.fit.curve, edf=np.full(axis.fit.curve.edf.size, np.nan))
    unbounded = tuple(replace(e, high=math.inf) if e.key == "K" else e for e in axis.fit.estimates)
    fit = replace(axis.fit, curve=curve, estimates=unbounded)
    text = dumps(to_document(replace(report, axes=(replace(axis, fit=fit, mean=math.nan),))))
    assert "NaN" not in text
    assert "Infinity" not in text
    jsonschema.validate(json.loads(text), schema())
    again = from_document(json.loads(text)).axes[0]
    assert math.isnan(again.mean)
    assert np.isnan(again.fit.curve.edf).all()
    assert again.fit["K"].high == math.inf


def test_every_finding_is_written_once_with_its_axis() -> None:
    """A script needs only one list for all warnings; the file of an axis has the findings about it."""
    report = consumer_report()
    own = Finding("warning", "step", "A jump.", axis="gyro_x")
    sensor, log = (Finding("info", "rate-given", "A rate.", axis=axis) for axis in ("gyro", None))
    axes = (replace(report.axes[0], findings=(own, own)), *report.axes[1:])
    report = replace(report, axes=axes, findings=(sensor, log))
    document: Any = json.loads(dumps(to_document(report)))
    assert [(f["code"], f["axis"]) for f in document["findings"]][:3] == [
        ("rate-given", "gyro"),
        ("rate-given", None),
        ("step", "gyro_x"),
    ]
    assert [f["code"] for f in document["findings"]].count("step") == 1
    assert "findings" not in document["axes"][0]
    of_axis: Any = axis_document(report, report.axes[0])
    assert [f["code"] for f in of_axis["findings"]] == ["rate-given", "rate-given", "step"]
    of_accel: Any = axis_document(report, report.axes[-1])
    assert [(f["code"], f["axis"]) for f in of_accel["findings"]][:1] == [("rate-given", None)]


def test_the_summary_has_the_numbers_of_usable_axes() -> None:
    """The summary is sorted by axis and term. The summary is empty if the sensor moved."""
    report = consumer_report()
    document: Any = to_document(report)
    assert [*document["summary"]] == [axis.name for axis in report.axes]
    term = document["axes"][0]["fit"]["terms"]["N"]
    assert document["summary"]["gyro_x"]["N"] == {
        k: term[k] for k in ("status", "value", "low", "high", "unit")
    }
    moved = replace(report, findings=(Finding("error", "motion", "Moved."),))
    assert to_document(moved)["summary"] == {}


def test_raw_signals_are_in_a_separate_file(tmp_path: Path) -> None:
    """Signals are read with the report. Without the file they are empty; an invalid file is an error."""
    report = small_report()
    (tmp_path / "report.json").write_text(dumps(to_document(report)), encoding="utf-8")
    assert load(tmp_path).axes[0].overview.low.size == 0
    (tmp_path / "signal.json").write_text(dumps(signal_document(report)), encoding="utf-8")
    found = load(tmp_path).axes[0].overview
    npt.assert_allclose(found.low, report.axes[0].overview.low, rtol=1e-7)
    npt.assert_allclose(found.time_s, report.axes[0].overview.time_s, rtol=1e-7)
    (tmp_path / "signal.json").write_text("[", encoding="utf-8")
    with pytest.raises(ReadError, match=r"signal\.json: not JSON"):
        load(tmp_path)


def test_load_accepts_the_file_or_its_folder(tmp_path: Path) -> None:
    """The output of a run contains the folder."""
    (tmp_path / "report.json").write_text(dumps(to_document(small_report())), encoding="utf-8")
    assert load(tmp_path).axes[0].name == load(tmp_path / "report.json").axes[0].name == "gyro_x"


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (
            ("axes", 2, "fit", "method"),
            7,
            "r.json: axes[2].fit.method: found 7, expected a text",
        ),
        (
            ("axes", 0, "fit", "terms", "N", "value"),
            "big",
            'r.json: axes[0].fit.terms.N.value: found "big", expected a number',
        ),
        (
            ("axes", 0, "fit", "terms", "N", "value"),
            None,
            ("r.json: axes[0].fit.terms.N.value: found null, expected a value that fits 'estimated'"),
        ),
        (
            ("axes", 1, "sensor"),
            "compass",
            ('r.json: axes[1].sensor: found "compass", expected "gyroscope" or "accelerometer"'),
        ),
        (
            ("axes", 0, "curve", "adev"),
            [1.0],
            "r.json: axes[0].curve.adev: found a list of 1, expected 21 items, like the other lists",
        ),
        (
            ("axes", 0, "curve", "used"),
            [99],
            "r.json: axes[0].curve.used: found the index 99, expected less than 21",
        ),
        (
            ("axes", 0, "rate_hz"),
            0,
            "r.json: axes[0].rate_hz: found 0, expected a number above 0",
        ),
        (
            ("axes", 0, "fit", "expression"),
            "N=x",
            (
                "r.json: axes[0].fit.expression: found a model that can't be read ('x' is not a number; "
                "write a sum such as 'N=1e-3 + B=2e-5 + K=3e-6 + GM(sigma=1e-4, T=50)'), expected a sum of "
                "terms with values"
            ),
        ),
        (
            ("schema",),
            "imucal/report/3",
            'r.json: the schema is "imucal/report/3", expected "imucal/report/4"',
        ),
    ],
)
def test_errors_contain_place_finding_and_expectation(
    place: tuple[Any, ...], value: object, message: str
) -> None:
    """The place is a path in the document."""
    document: Any = to_document(consumer_report())
    _set(document, place, value)
    with pytest.raises(ReadError) as caught:
        from_document(document, file="r.json")
    assert str(caught.value) == f"{message}; run 'imucal fit' again"


def test_a_missing_key_is_reported() -> None:
    """The error lists the existing keys."""
    document: Any = to_document(small_report())
    del document["axes"][0]["gaps"][:]
    document["axes"][0]["gaps"].append({"start_s": 1.0, "missing": 2})
    with pytest.raises(ReadError) as caught:
        from_document(document, file="r.json")
    assert str(caught.value) == (
        "r.json: axes[0].gaps[0]: found start_s, missing, expected the key 'duration_s'; "
        "run 'imucal fit' again"
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file, expected the report.json that imucal writes"),
        (b"time,gx\n", "not JSON (Expecting value: line 1 column 1 (char 0)), expected the report.json"),
        (b"[1]", "found [1], expected an object"),
        (b'{"schema": NaN}', "not JSON (it contains NaN), expected the report.json"),
        (b"\xff\xfe\xfa", "not JSON"),
        (b"{}", 'the schema is null, expected "imucal/report/4"'),
    ],
)
def test_load_refuses_other_files(tmp_path: Path, content: bytes | None, message: str) -> None:
    """The error is one message with the path, whatever the file contains."""
    file = tmp_path / "report.json"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ReadError) as caught:
        load(file)
    assert str(caught.value).startswith(f"{file}: {message}")


def test_every_truncation_is_refused_with_a_message(tmp_path: Path) -> None:
    """A truncated file gives neither a report nor another exception."""
    text = dumps(to_document(small_report()))
    file = tmp_path / "report.json"
    for size in range(0, len(text) - 2, 997):
        file.write_text(text[:size], encoding="utf-8")
        with pytest.raises(ReadError):
            load(file)


def test_settings_can_contain_numpy_values_and_paths() -> None:
    """Arrays, scalars, tuples and paths become plain JSON; other objects are an error of the caller."""
    assert to_json({"a": np.float64(1.5), "b": (1, 2), "p": Path("x/y"), "n": np.array([1.0, np.nan])}) == {
        "a": 1.5,
        "b": [1, 2],
        "p": "x/y",
        "n": [1.0, None],
    }
    with pytest.raises(TypeError, match="can't be written to a report"):
        to_json(object())


def _set(
    document: Any,  # noqa: ANN401 - a JSON document
    place: tuple[Any, ...],
    value: object,
) -> None:
    for key in place[:-1]:
        document = document[key]
    document[place[-1]] = value


def _skeleton(value: object) -> object:
    """Return the document without its floating-point numbers; keys keep their order."""
    if isinstance(value, dict):
        return [(key, _skeleton(item)) for key, item in value.items()]
    if isinstance(value, list):
        return [_skeleton(item) for item in value]
    return "number" if isinstance(value, float) else value


def _numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [number for item in value.values() for number in _numbers(item)]
    if isinstance(value, list):
        return [number for item in value for number in _numbers(item)]
    return [value] if isinstance(value, float) else []


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("fit.level", 1, "found 1, expected a number between 0 and 1"),
        ("fit.level", 0, "found 0, expected a number between 0 and 1"),
        ("samples", -1, "found -1, expected a whole number from 0"),
        ("samples", True, "found true, expected a whole number from 0"),
        ("samples", 2.0, "found 2.0, expected a whole number from 0"),
        ("duration_s", True, "found true, expected a number"),
        ("duration_s", None, "found null, expected a number"),
        ("duration_s", math.inf, "found Infinity, expected a finite number"),
        ("gaps", {}, "found {}, expected a list"),
        ("fit", "a" * 38, f'found "{"a" * 38}", expected an object'),
        ("fit", "a" * 39, f'found "{"a" * 39}…, expected an object'),
        ("fit", {}, "found no keys, expected the key 'method'"),
        ("curve.used", [0, 10], "found the index 10, expected less than 10"),
        ("curve.m", [1, 2], "found a list of 2, expected 10 items, like the other lists"),
        ("curve.tau_s", [1.0] * 10, "found averaging times that do not increase, expected increasing ones"),
        ("fit.goodness.band_hz", [1, 2, 3], "found [1, 2, 3], expected a list of 2"),
        ("fit.covariance", [], "found a list of 0, expected 1 items, like the other lists"),
        ("fit.terms.N.status", "bounded", "found 0.001, expected a value that fits 'bounded'"),
        ("axis", "w", 'found "w", expected "x" or "y" or "z"'),
        (
            "fit.goodness.lines",
            [{"frequency_hz": "a"}],
            'lines[0].frequency_hz: found "a", expected a number',
        ),
    ],
)
def test_every_value_is_validated(place: str, value: object, message: str) -> None:
    """A user or another program may have changed the file."""
    document: Any = to_document(small_report())
    _set(document, ("axes", 0, *place.split(".")), value)
    with pytest.raises(ReadError) as caught:
        from_document(document)
    assert str(caught.value).endswith(f"{message}; run 'imucal fit' again")
    assert str(caught.value).startswith(f"report: axes[0].{place.partition('.')[0]}")


#: Values that damage or another program could put into a file.
_WRONG: tuple[Any, ...] = (None, True, 10**400, "x", [[]], {})


def _places(value: object, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of each value; of a list, only of its first item."""
    found = [place]
    if isinstance(value, dict):
        for key, item in value.items():
            found += _places(item, (*place, key))
    if isinstance(value, list) and value:
        found += _places(value[0], (*place, 0))
    return found


def _shown(place: tuple[Any, ...]) -> str:
    """Return a path as in messages."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".")


def test_each_damaged_value_is_refused_at_its_place() -> None:
    """The error is a ReadError with the place of the value, of a list of the same length, or of an item."""
    report = _fitted_report()
    document: Any = json.loads(dumps(to_document(replace(report, findings=_report_with_fix().findings))))
    # Settings can be any JSON.
    places = [place for place in _places(document)[1:] if "settings" not in place[:-1]]
    refused: dict[tuple[Any, ...], list[str]] = {}
    for place in places:
        original = document
        for part in place:
            original = original[part]
        for value in _WRONG:
            _set(document, place, value)
            try:
                from_document(document, file="r.json")
            except ReadError as error:
                refused.setdefault(place, []).append(error.place)
        _set(document, place, original)
    for place, found in refused.items():
        parent = _shown(place[:-1])
        assert all(one.startswith(f"r.json: {parent}" if parent else "r.json") for one in found), place
    accepted = {_shown(place) for place in places if place not in refused}
    assert accepted == set()


def test_findings_are_validated() -> None:
    """They are in one list, not in the axes."""
    document: Any = to_document(small_report())
    document["findings"] = [3]
    with pytest.raises(ReadError, match=r"^report: findings\[0\]: found 3, expected an object"):
        from_document(document)


def test_the_text_of_a_document_is_readable() -> None:
    """The text has one key per line, plain lists on one line, unescaped characters, and never NaN."""
    document = {"a": {"b": [1, 2.5, None], "c": {}}, "d": [], "e": [{"f": "°"}, {"g": [[1], [2]]}], "h": True}
    assert dumps(document) == (
        '{\n  "a": {\n    "b": [1, 2.5, null],\n    "c": {}\n  },\n  "d": [],\n'
        '  "e": [\n    {\n      "f": "°"\n    },\n'
        '    {\n      "g": [\n        [1],\n        [2]\n      ]\n    }\n  ],\n  "h": true\n}\n'
    )
    with pytest.raises(ValueError, match="not JSON compliant"):
        dumps({"a": math.nan})
