"""Load an exported parameter file in an interpreter that has pymavlink.

``python pymavlink_probe.py FILE`` prints the version and the parameters as JSON.
"""

import contextlib
import io
import json
import sys
from importlib.metadata import version

from pymavlink.mavparm import MAVParmDict


def main() -> None:
    """Print the parameters read by MAVParmDict.load, which `param load` of MAVProxy calls."""
    parameters = MAVParmDict()
    with contextlib.redirect_stdout(io.StringIO()) as output:
        parameters.load(sys.argv[1])
    invalid = sum("Invalid line" in line for line in output.getvalue().splitlines())
    found = {"version": version("pymavlink"), "parameters": dict(parameters), "invalid_lines": invalid}
    sys.stdout.write(json.dumps(found) + "\n")


main()
