"""``imucal check``: compare a report with limits, for CI."""

import textwrap
from dataclasses import dataclass, replace
from pathlib import Path

import click

from imucal.checking import Baseline, CheckResult, Limits
from imucal.checking.verdict import Row, Verdict
from imucal.cli._fleet import is_fleet, read_fleet
from imucal.cli._printing import FULL, as_typed, print_json, print_note, width
from imucal.cli._report_input import load_calibrated, load_report, read_report, refuse_reading
from imucal.cli._verdicts import print_annotations, verdict_options, write_junit
from imucal.cli.context import misuse
from imucal.cli.log_request import LogRequest
from imucal.cli.options import ReportCommand, fleet_model, option, report_options, unwrapped
from imucal.cli.param_types import FILE, PATH
from imucal.errors import ReadError
from imucal.printable import printable
from imucal.report.result import Report

_COLOURS: dict[Verdict, str] = {"pass": "green", "fail": "red", "undecided": "yellow"}


_EPILOG = unwrapped("""
Limits (TOML):
  undecided = "pass"       # result if the interval contains the limit
  [gyroscope]              # or accelerometer, or one axis: [gyro_z]
  N = { max = 0.3, unit = "deg/sqrt(h)" }     # Q N B K R GM; default: SI
  minimum = { max = 10, unit = "deg/h" }      # also mean, std
  B = { max = 2, sensor = "ADIS16448" }       # times its data sheet's figure
  [log]
  duration = { min = 2, unit = "h" }          # also rate, gaps, missing
  [calibration.gyroscope]  # or calibration.accelerometer
  scale = { max = 2, unit = "%" }             # bias, misalignment, residual
  g_sensitivity = { max = 1, unit = "deg/s/g" }
  [findings]
  level = "warning"        # forbid this and more severe; also forbid, allow
  [baseline]
  report = "golden/report.json"
  max_increase = 0.2

Examples:
  imucal check still-imucal --limits limits.toml
  imucal check still.mcap --limits limits.toml --junit imucal.xml --github
  imucal check still-imucal --baseline golden-imucal --json | jq .verdict
  imucal check new-unit.mcap --fleet fleet
  imucal check poses-calibration --limits limits.toml
  imucal check still-imucal --config imu.yaml
  imucal check results-imucam.txt                 # the residuals of Kalibr
  imucal check still-imucal --config results-imucam.txt
  imucal check innovations.csv                    # a column nis, and dof

Exit codes: 0 nothing failed, 1 a limit failed, 2 usage or a wrong limits
file, 3 the report or log can't be read, 4 the data can't be analysed.
""")


@click.command(cls=ReportCommand, epilog=_EPILOG)
@option(
    "--limits", "limits_file", metavar="FILE", type=FILE, help="Check against the limits in this TOML file."
)
@option(
    "--baseline",
    metavar="REPORT",
    type=click.Path(),
    help="Compare with an older report (report.json or its folder); by default, N, B and K may grow by 20 %.",
)
@option("--fleet", metavar="FLEET", type=PATH, help="Compare with the units in the folder of a fleet.")
@option("--config", metavar="FILE", type=FILE, help="Check the noise parameters in a filter's config file.")
@option(
    "--imu",
    metavar="NUMBER",
    type=click.IntRange(min=0),
    help="Number of the report's IMU in Kalibr's results of several IMUs.",
)
@option(
    "--dof",
    metavar="NUMBER",
    type=click.IntRange(min=1),
    help="Number of components of an innovation, for a CSV file without a column dof.",
)
@fleet_model()
@option(
    "--undecided",
    type=click.Choice(["pass", "fail"]),
    help="Result if the interval contains the limit. [default: from the limits file, or pass]",
)
@verdict_options
@report_options
def command(
    *,
    limits_file: Path | None,
    baseline: str | None,
    fleet: Path | None,
    config: Path | None,
    imu: int | None,
    dof: int | None,
    fleet_model: str | None,
    undecided: str | None,
    as_json: bool,
    junit: Path | None,
    github: bool,
    request: LogRequest,
) -> None:
    """Pass or fail a report, a log or a calibration against limits.

    REPORT is a report.json, its folder, a log (which is characterised first), or the folder of a
    calibration. A limit passes if the whole interval is within it, and fails if the whole interval is
    beyond it. It is undecided if the interval contains the limit: the log is too short. Undecided limits
    do not fail the check, except with --undecided fail or the same line in the limits file.

    --fleet compares each term with the range of the fleet's units. It passes if its whole interval is
    in the range. It fails if p is below 5 %, adjusted for the number of terms (Holm): a unit of the
    fleet fails with that probability. Otherwise it is undecided.

    --config compares the noise parameters of a filter's file with the values that 'imucal export'
    writes. Too small a value fails. Too large a value fails if it matches a common mistake: a factor of
    the rate, degrees, g, a square, or the number of another term. Each row contains the line to write
    instead.

    REPORT may also be the results of Kalibr's camera-IMU calibration (results-imucam.txt), whose residuals
    are compared with their expectation, or a CSV file with the normalised innovations of a filter (nis).
    With --config, Kalibr's results give a factor for each number of imu.yaml.
    """
    against = _Against(limits_file, baseline, fleet, fleet_model, config, imu)
    result = _checked(request, against, dof)
    if undecided is not None:
        result = replace(result, undecided_fails=undecided == "fail")
    if junit is not None:
        from imucal.checking.verdict import cases_of

        write_junit(junit, cases_of(result), command="imucal check", source=result.source)
    _print(result, as_json=as_json, github=github, file=str(limits_file or config or ""))
    if not result.passed:
        click.get_current_context().exit(1)


@dataclass(frozen=True)
class _Against:
    """What the options compare a report with."""

    limits_file: Path | None
    baseline: str | None
    fleet: Path | None
    fleet_model: str | None
    config: Path | None
    imu: int | None

    @property
    def anything(self) -> bool:
        return any((self.limits_file, self.baseline, self.fleet, self.config))


def _print(result: CheckResult, *, as_json: bool, github: bool, file: str) -> None:
    """Print the verdicts as JSON or as a table, and the annotations of a file."""
    from imucal.checking.verdict import cases_of, to_document

    if as_json:
        print_json(to_document(result))
    else:
        click.echo(_table(result))
    if github:
        print_annotations(cases_of(result), file=file, err=as_json)


def _checked(request: LogRequest, against: _Against, dof: int | None) -> CheckResult:
    """Check what REPORT names: a report or a log, a calibration, or the results of an estimator."""
    from imucal.calibration.writer import is_calibration
    from imucal.checking.innovations import are_innovations
    from imucal.checking.kalibr_results import are_results

    path = Path(request.logs[0]) if len(request.logs) == 1 else Path()
    if against.imu is not None and (against.config is None or not are_results(against.config)):
        misuse("--imu chooses an IMU of Kalibr's results; give --config results-imucam.txt too")
    if are_innovations(path):
        return _of_innovations(request, path, against, dof)
    if dof is not None:
        misuse("--dof is for a CSV file with the normalised innovations of a filter; give its file")
    if are_results(path):
        return _of_residuals(request, path, against)
    if request.logs and is_calibration(path):
        return _of_calibration(request, against)
    return _of_report(request, against)


def _of_innovations(request: LogRequest, path: Path, against: _Against, dof: int | None) -> CheckResult:
    """Check the normalised innovations of a filter; a usage error for anything else."""
    from imucal.checking.innovations import check_innovations

    if against.anything:
        misuse(f"{path} contains innovations, which are compared with their expectation; give the file alone")
    refuse_reading(request, f"{path} contains innovations")
    return check_innovations(path, dof)


def _of_residuals(request: LogRequest, path: Path, against: _Against) -> CheckResult:
    """Check the residuals of Kalibr; a usage error for anything else."""
    from imucal.checking.kalibr_results import check_residuals

    if against.anything:
        misuse(f"{path} is a result of Kalibr; compare it with 'imucal check REPORT --config FILE'")
    refuse_reading(request, f"{path} is a result of Kalibr")
    result = check_residuals(path)
    command = f"imucal check REPORT --config {as_typed(path)}"
    print_note(f"With the report of the IMU at rest, each number of imu.yaml has a factor: {command}")
    return result


def _of_report(request: LogRequest, against: _Against) -> CheckResult:
    """Check a report, or a log that is characterised first."""
    from imucal.checking import check

    limits = _limits(against)
    older = _older(limits, against.baseline)
    # Report errors of the fleet before reading the log.
    units = None if against.fleet is None else read_fleet(against.fleet, against.fleet_model)
    report = load_report(request)
    result = check(report, limits, baseline=older)
    rows = result.rows
    if units is not None:
        from imucal.fleet.as_report import check_fleet

        rows += check_fleet(report, units)
    if against.config is not None:
        rows += _config_rows(against.config, report, against.imu)
    return replace(result, rows=rows)


def _config_rows(config: Path, report: Report, imu: int | None) -> tuple[Row, ...]:
    """Check the config file of a filter, or Kalibr's results with the numbers of imu.yaml."""
    from imucal.checking import check_config
    from imucal.checking.kalibr_results import are_results, check_numbers, check_residuals

    if are_results(config):
        return check_residuals(config).rows + check_numbers(config, report, imu)
    return check_config(config, report)


def _of_calibration(request: LogRequest, against: _Against) -> CheckResult:
    """Check a calibration; a usage error for anything but limits."""
    from imucal.checking import read_limits
    from imucal.checking.calibrated import check_calibration

    limits_file = against.limits_file
    if limits_file is None or against.baseline or against.fleet or against.config:
        misuse(f"{request.logs[0]} is a calibration, which only limits can check; give --limits FILE alone")
    return check_calibration(load_calibrated(request), read_limits(limits_file))


def _older(limits: Limits, baseline: str | None) -> Report | None:
    """Return the baseline of the limits; None if there is none."""
    if limits.baseline is None or limits.baseline.report is None:
        return None
    return read_report(baseline or limits.baseline.report)


def _limits(against: _Against) -> Limits:
    """Return the limits; none if only a fleet or a config is given."""
    from imucal.checking import read_limits

    limits_file, baseline, fleet = against.limits_file, against.baseline, against.fleet
    if fleet is None and against.fleet_model is not None:
        misuse(
            "--sensor needs a fleet; give --fleet FLEET too, or name a part in the limits: "
            'gyroscope.N = { max = 1.5, sensor = "BMI088" }'
        )
    if fleet is not None and not is_fleet(fleet):
        expected = "expected the folder of a fleet that imucal fleet run writes"
        raise ReadError(f"found no fleet, {expected}", place=fleet)
    if not against.anything:
        misuse(
            "nothing to check against; give --limits FILE, --baseline REPORT, --fleet FLEET or --config FILE"
        )
    limits = Limits() if limits_file is None else read_limits(limits_file)
    if baseline is not None:
        limits = replace(limits, baseline=replace(limits.baseline or Baseline(), report=Path(baseline)))
    elif limits.baseline is not None and limits.baseline.report is None:
        misuse(f'{limits_file}: [baseline] has no report; add report = "…", or give --baseline REPORT')
    return limits


def _table(result: CheckResult) -> str:
    """Return the verdicts as coloured lines that fit the terminal, and the overall result."""
    where = max((len(row.where) for row in result.rows), default=0)
    rule = min(max((len(row.rule) for row in result.rows), default=0), 32)
    lines = [line for row in result.rows for line in _lines(row, where, rule)]
    words: dict[Verdict, str] = {"pass": "passed", "fail": "failed", "undecided": "undecided"}
    counts = ", ".join(f"{result.count(verdict)} {word}" for verdict, word in words.items())
    note = ""
    if result.count("undecided"):
        note = "; undecided fails" if result.undecided_fails else "; undecided doesn't fail"
    word, colour = ("PASS", "green") if result.passed else ("FAIL", "red")
    # Colour codes have no width.
    # Residuals have no intervals.
    level = f"intervals at {result.level:.0%}" if any(map(_has_interval, result.rows)) else ""
    remark = f" ({(level + note).removeprefix('; ')})" if level or note else ""
    total = textwrap.wrap(f"{word}: {counts}{remark}", width())
    total[0] = total[0].replace(word, click.style(word, fg=colour, bold=True), 1)
    return "\n".join(lines + total)


def _has_interval(row: Row) -> bool:
    """Return whether a row is judged by an interval; a row in words may have none."""
    return not row.in_words or (row.measured is not None and row.measured.low < row.measured.high)


def _lines(row: Row, where: int, rule: int) -> list[str]:
    verdict = click.style(f"{row.verdict:<9}", fg=_COLOURS[row.verdict])
    start = 9 + 1 + where + 1
    measured = None if row.instead or row.in_words else row.measured
    if measured is not None and start + rule + 1 + len(measured.text()) <= width():
        return [f"{verdict} {row.where:<{where}} {row.rule:<{rule}} {measured.text()}"]
    if measured is not None and width() < FULL:
        place, *more = textwrap.wrap(f"{row.where:<{where}} {row.rule}", width() - 10)
        return [f"{verdict} {place}", *(f"{' ' * 8}{line}" for line in (*more, measured.text()))]
    found = f"{row.found}; write" if row.instead else row.found
    first, *rest = textwrap.wrap(printable(found), width() - start)
    # The line to copy must not be wrapped.
    rest += [printable(row.instead)] if row.instead else []
    return [f"{verdict} {row.where:<{where}} {first}", *(" " * start + line for line in rest)]
