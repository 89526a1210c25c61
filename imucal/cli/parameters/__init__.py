"""Parameters of commands: types that say what is right, and options that several commands share."""

from imucal.cli.parameters.log_request import LogRequest, log_options
from imucal.cli.parameters.reading_options import reading_options
from imucal.cli.parameters.shared_options import quiet_option, shown

__all__ = ["LogRequest", "log_options", "quiet_option", "reading_options", "shown"]
