"""``imucal apply``: copy a log with the samples corrected by a calibration."""

from pathlib import Path
from typing import Any

import click

from imucal.cli._printing import BYTES, echo, print_findings, print_json, print_note, progress
from imucal.cli.log_request import lent
from imucal.cli.options import (
    OUTPUT,
    Command,
    flag,
    out_option,
    quiet,
    reading_options,
    topic,
    unwrapped,
    verbose,
)
from imucal.cli.param_types import PATH

SCHEMA = "imucal/apply/1"


_EPILOG = unwrapped("""
Calibrations: the folder of imucal calibrate, or of imucal thermal;
imu_calibration.yaml of imucal export --to yaml; imu.yaml of Kalibr or
OpenVINS with intrinsics; calibration.json of librealsense; the two files of
imu_tk.

Examples:
  imucal apply poses-calibration flight.mcap -o corrected.mcap
  imucal apply ramp-thermal flight.mcap -o corrected.mcap
  imucal apply imu.yaml drive.bag -o corrected.bag --topic /imu/data
  imucal apply calibration.json log.csv -o corrected.csv

Exit codes: 0 done, 2 usage, 3 log or calibration not readable, 4 they do not
fit, or the log is damaged or already corrected, 5 output not writable.
""")


@click.command(cls=Command, epilog=_EPILOG)
@click.argument("calibration", metavar="CALIBRATION", type=PATH)
@click.argument("log", metavar="LOG", type=click.Path(readable=False))
@out_option("PATH", required=True, help="Write the corrected log to PATH, which must not exist.")
@flag("--json", "as_json", group=OUTPUT, help="Print what was corrected as JSON on standard output.")
@quiet
@verbose
@topic
@reading_options
def command(
    *,
    calibration: Path,
    log: str,
    out: Path,
    as_json: bool,
    topic: tuple[str, ...],
    reading: dict[str, Any],
) -> None:
    """Correct the IMU of a LOG of any size: bias, scale, misalignment and g-sensitivity.

    The corrected log has the format of LOG: MCAP, a ROS 1 or ROS 2 bag, or a text table. Only the
    samples of the IMU change, in the units of the log. All other topics, columns, stamps and the order
    stay byte for byte. A log that is already corrected is refused.
    """
    from imucal.calibration.intrinsics_files import load_calibration
    from imucal.correction.rewriting import apply_to_log
    from imucal.readers.read_options import options_of
    from imucal.temperature.document import load_thermal
    from imucal.temperature.writer import is_thermal

    found = load_thermal(calibration) if is_thermal(calibration) else load_calibration(calibration)
    with lent([log]) as logs, logs.errors_named(), progress("correcting", *BYTES) as update:
        options = options_of(topic=topic, **reading, progress=update)
        applied = apply_to_log(found, logs.paths[0], out, options)
    where = ", ".join(applied.corrected)
    if as_json:
        document = {
            "schema": SCHEMA,
            "calibration": str(calibration),
            "log": applied.original,
            "written": str(applied.path),
            "corrected": list(applied.corrected),
            "samples": applied.samples,
            "findings": [
                {"level": one.level, "code": one.code, "text": one.text} for one in applied.findings
            ],
        }
        print_json(document)
    else:
        echo(f"Corrected {applied.samples} samples of {where}; everything else is unchanged.")
    print_findings(applied.findings)
    print_note(f"Wrote {applied.path}")
