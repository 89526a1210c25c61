"""The folder of a diagnosis: pictures of the rows that failed or warned, page, document and schema."""

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from lxml import html
from PIL import Image

from imucal.errors import WriteError
from imucal.findings import Finding
from imucal.health import Diagnosis, diagnose
from imucal.health.document import schema, to_document
from imucal.health.evidence import Evidence, thinned
from imucal.health.figure import picture, row_figure
from imucal.health.page import description_of, render_page
from imucal.health.writer import write_diagnosis
from imucal.recording import StampTrace
from tests.benchmarks.doctor_schema import doctor_schema
from tests.health.cases import Case, cases, clean, delayed, diagnosis_of, fastest, gyroscope, row_of

#: Most points of a picture: three curves with two for each pixel.
MOST_POINTS = 10_000

CASES = tuple(cases())
BAD = [case for case in CASES if case.status in {"warn", "fail"}]
#: Cases of findings without stamps, and of an axis that is not in the log: there is nothing to draw.
NOT_DRAWN = {"jitter", "bursts", "jump", "drift", "no z"}


def case_of(code: str, name: str) -> Case:
    return next(case for case in CASES if (case.code, case.name) == (code, name))


def evidence_of(code: str, name: str) -> Evidence:
    evidence = case_of(code, name).row.evidence
    assert evidence is not None
    return evidence


def marked(evidence: Evidence) -> np.ndarray:
    return np.concatenate([curve.x for curve in evidence.marks])


@pytest.fixture(scope="module")
def sick() -> Diagnosis:
    """Return the diagnosis of a log with a clipped axis, a flipped one, and spikes."""
    x = clean().gyroscope * [1, 1, -1]
    x[:, 0] = np.clip(x[:, 0], -1, 1)
    x[100::900, 1] += 3
    return diagnose(replace(clean(), gyroscope=x).recording())


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.code}: {case.name}")
def test_each_row_has_each_status_and_evidence_if_it_is_bad(case: Case) -> None:
    """Evidence is small, and sentences are whole."""
    row = case.row
    assert row.status == case.status, row
    assert row.found[-1] in ".?"
    assert not row.advice or row.advice[-1] == "."
    assert (row.evidence is not None) == (case in BAD and case.name not in NOT_DRAWN)
    if row.evidence is not None:
        assert sum(curve.x.size for curve in row.evidence.curves) < MOST_POINTS
        assert all(curve.x.shape == curve.y.shape for curve in row.evidence.curves)


def test_a_clip_is_inside_the_window_and_marked() -> None:
    """The marks are the samples at the limit, which is drawn."""
    evidence = evidence_of("saturated", "clipped")
    samples, marks = evidence.curves
    assert samples.label == "gyro_y"
    assert marks.y == pytest.approx(1.0)
    assert evidence.limits[0].value == 1.0
    assert samples.x[0] < marks.x[0] < marks.x[-1] < samples.x[-1]
    at_limit = np.flatnonzero(clean().gyroscope[:, 1] >= 1) / clean().rate_hz
    assert set(np.round(marks.x, 4)) <= set(np.round(at_limit, 4))


def test_a_stuck_part_is_marked_from_its_start() -> None:
    """It begins 1 s before the fastest sample, and the axis moves before it."""
    evidence = evidence_of("stuck", "2 s")
    assert marked(evidence)[0] == pytest.approx((fastest() - 200) / 200, abs=0.011)
    assert evidence.curves[0].x[0] < marked(evidence)[0]


def test_bad_samples_are_marked_where_they_are() -> None:
    """Spikes, repeated, interpolated and missing samples, by their indices."""
    rate = clean().rate_hz
    places = {
        code: np.round(marked(evidence_of(code, name)) * rate).astype(int)
        for code, name in (
            ("spikes", "some"),
            ("held-samples", "every second"),
            ("interpolated-samples", "every fourth"),
            ("not-finite", "NaN"),
        )
    }
    assert set(places["spikes"] % 900) == {100}
    assert set(places["held-samples"] % 2) == {1}
    assert np.mean(places["interpolated-samples"] % 4 == 2) > 0.8
    assert set(places["not-finite"]) <= set(range(700, 800))
    assert places["not-finite"][0] == 700


def test_a_gap_is_marked_at_its_end() -> None:
    """The time between the samples is that of 101 periods."""
    (marks,) = evidence_of("gaps", "100 lost").marks
    assert marks.x == pytest.approx([1100 / 200])
    assert marks.y == pytest.approx([505.0])


def test_units_and_gravity_are_compared_with_what_is_right() -> None:
    """The length of gravity in g; angles of a gyroscope in deg/s; the axis that is up."""
    length = evidence_of("accelerometer-unit", "g")
    assert np.median(length.curves[0].y) == pytest.approx(1.0, abs=0.03)
    assert length.limits[0].value == pytest.approx(9.80665)
    assert len(length.shaded) == 9
    both = evidence_of("accelerometer-unit", "swapped")
    assert [curve.label for curve in both.curves] == [
        "length of the accelerometer",
        "length of the gyroscope",
    ]
    turns = evidence_of("gyroscope-unit", "deg/s").curves[1]
    assert np.median(turns.x / turns.y) == pytest.approx(57.3, rel=0.05)
    up = {curve.label: np.nanmedian(curve.y[:200]) for curve in evidence_of("up", "z-down").curves}
    assert up["accel_z"] == pytest.approx(9.8, abs=0.3)
    assert abs(up["accel_x"]) < 1


def test_the_own_order_comes_first_and_the_best_second() -> None:
    """Bars have the names of the orders."""
    evidence = evidence_of("axes", "z flipped")
    assert evidence.names[:2] == ("x=x y=y z=z (this log)", "x=x y=y z=-z")
    assert evidence.curves[0].x[0] > 50
    assert evidence.curves[0].x[1] < 1


def test_the_error_is_least_at_the_delay() -> None:
    """The curve has its minimum where the row reports the delay."""
    for name, delay_ms in (("6 ms", 6.0), ("-30 ms", -30.0)):
        evidence = evidence_of("sensor-delay", name)
        (curve,) = evidence.curves
        assert curve.x[int(curve.y.argmin())] == pytest.approx(delay_ms, abs=2.0)
        assert evidence.limits[1].value == pytest.approx(delay_ms, abs=0.5)


def test_the_line_of_a_propeller_is_marked_in_the_spectrum() -> None:
    """The largest density is at the line."""
    evidence = evidence_of("tone", "propeller")
    (limit,) = evidence.limits
    (curve,) = evidence.curves
    near = np.abs(curve.x - limit.value) < 2
    assert curve.y[near].max() > 8 * np.median(curve.y)


def test_stamps_that_go_back_are_marked() -> None:
    """The reader keeps the extremes of the stamps; clocks are compared with the log."""
    trace = StampTrace(
        index=np.array([1, 2, 3]),
        interval_s=np.array([0.01, -0.02, 0.04]),
        compared=np.array([1, 2]),
        late_s=np.array([0.001, 0.5]),
    )
    notes = tuple(
        Finding("warning", code, "Look.") for code in ("clock-jump", "uneven-stamps", "clocks-differ")
    )
    diagnosis = diagnose(replace(clean().recording(), findings=notes, stamps=(trace,)))
    for code in ("rate", "stamps"):
        evidence = row_of(diagnosis, code).evidence
        assert evidence is not None
        (marks,) = evidence.marks
        assert (marks.x.tolist(), marks.y.tolist()) == ([2.0], [-20.0])
    clocks = row_of(diagnosis, "clocks-differ").evidence
    assert clocks is not None
    assert clocks.curves[0].y.tolist() == [1.0, 500.0]


def test_thinning_keeps_extremes() -> None:
    """The highest and the lowest of 100 000 points stay, in order."""
    y = np.sin(np.arange(100_000.0))
    y[[777, 50_001]] = 9.0, -9.0
    x, thin = thinned(np.arange(100_000.0), y, most=1000)
    assert x.size <= 1000
    assert np.all(np.diff(x) >= 0)
    assert {777.0, 50_001.0} <= set(x)
    assert (thin.max(), thin.min()) == (9.0, -9.0)


@pytest.mark.parametrize(
    "case", [case for case in BAD if case.name not in NOT_DRAWN][::4], ids=lambda c: c.code
)
def test_pictures_can_be_drawn(case: Case) -> None:
    """All curves, marks, limits and texts are in the figure; it has a size."""
    row = case.row
    assert row.evidence is not None
    (axes,) = row_figure(diagnosis_of(case), row, row.evidence).axes
    labels = axes.get_legend_handles_labels()[1]
    assert {curve.label for curve in row.evidence.curves if curve.look != "bars"} <= set(labels)
    assert axes.get_xlabel() == row.evidence.x_label
    assert {limit.label for limit in row.evidence.limits} <= {text.get_text() for text in axes.texts}


def test_the_folder_has_a_picture_of_each_bad_row(tmp_path: Path, sick: Diagnosis) -> None:
    """The document is that of --json, and valid; the page contains the pictures and loads nothing."""
    files = write_diagnosis(sick, tmp_path / "out")
    bad = [row.code for row in sick.rows if row.status in {"fail", "warn"}]
    assert set(bad) == {"axes", "saturated", "spikes"}
    assert {path.name for path in files} == {
        "doctor.json",
        "doctor.html",
        *(f"doctor-{code}.png" for code in bad),
    }
    with Image.open(tmp_path / "out" / "doctor-axes.png") as image:
        assert image.size == (1600, 640)
    text = (tmp_path / "out" / "doctor.html").read_text(encoding="utf-8")
    assert len(text) < 400_000
    page = html.fromstring(text)
    assert [image.get("alt") for image in page.iter("img")] == [
        description_of(row) for row in sick.rows if row.code in bad
    ]
    assert re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', text) == []
    links = {link.get("href") for link in page.iter("a")}
    assert {f"#picture-{code}" for code in bad} <= links
    assert len({one.get("id") for one in page.xpath("//*[@id]")}) == len(page.xpath("//*[@id]"))
    assert [one.tag for one in page.iter("h1", "h2", "h3")] == ["h1", "h2", "h2", *["h3"] * len(bad)]


def test_a_foreign_folder_is_refused_and_an_old_diagnosis_replaced(tmp_path: Path, sick: Diagnosis) -> None:
    """Pictures of an older diagnosis vanish, other files stay."""
    out = tmp_path / "out"
    write_diagnosis(sick, out)
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    fit = diagnosis_of(case_of("axes", "clean"))
    write_diagnosis(fit, out)
    assert sorted(path.name for path in out.iterdir()) == ["doctor.html", "doctor.json", "notes.txt"]
    assert "<img" not in (out / "doctor.html").read_text(encoding="utf-8")
    (out / "doctor.json").write_text("{}", encoding="utf-8")
    with pytest.raises(WriteError, match=r"contains doctor\.html, doctor\.json, notes\.txt but no diagnosis"):
        write_diagnosis(fit, out)


def test_names_of_a_log_are_escaped(sick: Diagnosis) -> None:
    """Names of files and topics are text, also in pictures."""
    evil = replace(
        sick, source=replace(sick.source, path="<script>$x_{$.csv", topics=("/<img src=x>", "\x1b[31m\u202e"))
    )
    row = row_of(evil, "axes")
    assert row.evidence is not None
    content = picture(evil, row, row.evidence)
    with Image.open(io.BytesIO(content)) as image:
        assert image.format == "PNG"
    text = render_page(evil, {"axes": content}, lambda fix: fix.value)
    assert "<script>$" not in text
    assert "<img src=x" not in text
    assert "\x1b" not in text
    assert "\u202e" not in text


def test_the_option_of_a_fix_is_shown() -> None:
    """The caller knows how its options are spelled."""
    diagnosis = diagnose(gyroscope(np.degrees)())
    text = render_page(diagnosis, {}, lambda fix: f"--{fix.argument} {fix.value}")
    assert "<code>--gyro_unit deg/s</code>" in text


@pytest.mark.parametrize("make", [clean, lambda: delayed(-0.03)])
def test_documents_are_valid_by_the_schema(make: Callable[[], object]) -> None:
    """The schema refuses other statuses; it allows more keys."""
    document = to_document(diagnose(make().recording()))  # type: ignore[attr-defined]
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(schema())
    validator.validate(document)
    assert "evidence" not in str(document)
    with pytest.raises(jsonschema.ValidationError):
        validator.validate({**document, "status": "maybe"})


def test_the_schema_file_is_current() -> None:
    """Run `python -m tests.benchmarks.doctor_schema` after a change of the dataclasses."""
    assert schema() == doctor_schema()
    written = doctor_schema()
    for part in (written, *written["$defs"].values()):
        assert all("description" in value for value in part["properties"].values())
