"""The command line: parse, call, print. Each command has a file and a line in `COMMANDS`."""

import difflib
import errno
import gc
import importlib
import io
import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn, TextIO, TypeAlias

import click
from click.shell_completion import CompletionItem

from imucal._version import __version__
from imucal.cli._fixes import fields_of, message_of
from imucal.errors import EXIT_CODES, DataError, ImucalError, WriteError
from imucal.printable import printable, printable_json
from imucal.resources import single_matrix_thread

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

__all__ = ["COMMANDS", "main"]


#: What imucal wrote: a folder by the file in it, or a file that is no log.
ResultKind: TypeAlias = Literal["report", "calibration", "fleet", "file"]

_RESULTS: tuple[tuple[str, ResultKind], ...] = (
    ("report.json", "report"),
    ("calibration.json", "calibration"),
    ("fleet.json", "fleet"),
    ("run-*.fleet", "fleet"),
)
#: Suffixes of files that imucal writes and that are not logs.
_NO_LOGS = frozenset({".yaml", ".yml", ".toml", ".html", ".png", ".md", ".pdf", ".svg"})


def _kind_of_result(path: Path) -> ResultKind | None:
    """Return what imucal wrote at a path, or None."""
    if path.is_dir():
        return next((kind for name, kind in _RESULTS if any(path.glob(name))), None)
    by_name = {name: kind for name, kind in _RESULTS if name.endswith(".json")}
    return by_name.get(path.name, "file" if path.suffix.lower() in _NO_LOGS else None)


class LazyGroup(click.Group):
    """A group that imports a command when it is called.

    `table` is command -> (module of `imucal.cli`, line of help). The module defines `command`;
    ``module:name`` chooses another name. `of_a_log` is (purpose, command) for the hint if the user types a
    log instead of a command, and `of_a_result` the same for a folder or file that imucal wrote, by its kind.
    """

    def __init__(
        self,
        *,
        table: Mapping[str, tuple[str, str]],
        of_a_log: tuple[str, str],
        of_a_result: Mapping[ResultKind, tuple[str, str]],
        **attributes: Any,  # noqa: ANN401 - as click has them
    ) -> None:
        super().__init__(**attributes)
        self.table, self._of_a_log, self._of_a_result = table, of_a_log, of_a_result

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in self.table:
            return None
        module, _, name = self.table[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(f"imucal.cli.{module}"), name or "command")
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return a command; the error for an unknown one suggests the most similar name."""
        from imucal.remote.addresses import is_url, shown

        name = args[0]
        if name in self.table or name.startswith("-") or ctx.resilient_parsing:
            return super().resolve_command(ctx, args)
        if near := difflib.get_close_matches(name.lower(), self.table, n=1):
            hint = f"did you mean {near[0]!r}?"
        elif Path(name).exists() or is_url(name):
            kind = None if is_url(name) else _kind_of_result(Path(name))
            # The query of a URL may contain a secret.
            name = shown(name) if is_url(name) else name
            purpose, command = self._of_a_log if kind is None else self._of_a_result.get(kind, ("", ""))
            typed = command.replace("PATH", shlex.quote(name))
            hint = f"to {purpose}, type '{typed}'" if typed else f"expected one of {', '.join(self.table)}"
        else:
            hint = f"expected one of {', '.join(self.table)}"
        raise click.UsageError(f"No such command {name!r}; {hint}", ctx)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return completions without importing the commands, so that the Tab key responds at once."""
        names = [
            CompletionItem(name, help=summary)
            for name, (_, summary) in self.table.items()
            if name.startswith(incomplete)
        ]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in self.table.items()])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_epilog(ctx, formatter)
        if ctx.parent is None:
            with formatter.section("Exit codes"):
                formatter.write_dl([(str(code), meaning) for code, (meaning, _) in EXIT_CODES.items()])


#: Command -> its module, and its line of help.
COMMANDS: dict[str, tuple[str, str]] = {
    "info": ("info", "List the topics, rates, duration, units and gaps of a log."),
    "doctor": ("doctor", "Check that a log of a moving IMU is fit for a filter."),
    "fit": ("fit", "Fit a noise model to every axis of a log and write a report."),
    "export": ("export", "Write the config files of Kalibr, VINS, ORB-SLAM3, PX4 and others."),
    "check": ("check", "Check a report or a log against limits, for CI."),
    "plan": ("plan", "Compute how long to record for a given precision."),
    "calibrate": ("calibrate", "Find bias, scale and misalignment from a log of rests and turns."),
    "thermal": ("thermal", "Find the bias over temperature from a log that heats and cools."),
    "apply": ("apply", "Correct the IMU of a log by a calibration; other topics stay."),
    "compare": ("compare", "Find the terms of two reports that differ significantly."),
    "drift": ("drift", "Predict the drift of dead reckoning after a rest."),
    "adev": ("adev", "Print the Allan deviations of every axis as CSV or JSON."),
    "decompose": ("decompose", "Draw the bias of every axis over time, and its parts."),
    "sensor": ("sensor", "Print the noise figures of a part's data sheet, by its name."),
    "simulate": ("simulate", "Write a log with known noise (CSV, MCAP, ROS 1 or ROS 2 bag)."),
    "fleet": ("fleet", "Characterise many logs of many units: run, status, report."),
    "completion": ("completion", "Print the shell's completion script (bash, zsh, fish)."),
}

#: Error numbers of writing to a full or broken disk.
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})


def _print_version(ctx: click.Context, _: click.Parameter, wanted: object) -> None:
    if wanted and not ctx.resilient_parsing:
        click.echo(_version_lines())
        ctx.exit()


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    of_a_log=("fit a log", "imucal fit PATH"),
    of_a_result={
        "report": ("write a config file from a report", "imucal export PATH --to kalibr"),
        "calibration": ("write a config file from a calibration", "imucal export PATH --to kalibr"),
        "fleet": ("print the state of a fleet", "imucal fleet status PATH"),
    },
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Print the version of imucal.",
)
def imucal() -> None:
    """Turn a recording of an IMU at rest into a noise model.

    Start with `imucal fit LOG`: it reads the log, computes the Allan curves, fits every axis
    and writes a report.
    """


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and end the process with its exit code."""
    _fill_streams()
    single_matrix_thread()
    # A command needs its objects to the end, so searching them for cycles wastes a tenth of the time.
    gc.set_threshold(200_000)
    sys.exit(_run(arguments))


def _fill_streams() -> None:
    """Replace closed standard streams by the null device."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # Keep them open: files opened later would otherwise get the standard descriptors.
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115
    # A run of hours must not end because nobody reads its output.
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is getattr(sys, f"__{name}__") and isinstance(stream, io.TextIOWrapper):
            setattr(sys, name, _until_unread(stream))


class _UntilUnread(io.FileIO):
    """A stream that discards what is written after its reader has gone."""

    is_unread = False

    def write(self, data: "ReadableBuffer") -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            self.is_unread = True
            _to_null(self.fileno())
            return memoryview(data).nbytes


def _until_unread(stream: io.TextIOWrapper) -> io.TextIOWrapper:
    """Return a standard stream whose reader may go."""
    raw = _UntilUnread(stream.fileno(), "w", closefd=False)
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
    )


def _is_unread(stream: TextIO) -> bool:
    """Return whether the reader of a stream has gone."""
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    return isinstance(raw, _UntilUnread) and raw.is_unread


def _run(arguments: Sequence[str] | None) -> int:
    """Run a command and return its exit code, also if the reader of its output is gone."""
    code = _outcome(arguments)
    sys.stdout.flush()
    sys.stderr.flush()
    return 141 if _is_unread(sys.stdout) else code


def _outcome(arguments: Sequence[str] | None) -> int:
    """Run a command and return its exit code; exceptions become messages here."""
    typed = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in typed
    try:
        code = imucal.main(
            args=arguments,
            prog_name="imucal",
            standalone_mode=False,
            # For commands that print how to continue.
            obj=typed,
        )
        sys.stdout.flush()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG and not os.environ.get("IMUCAL_DEBUG"):
            name = str(error.filename or "")
            return _explain(
                click.UsageError(f"a name of {len(name)} characters is too long for a file: {name}"),
                as_json=as_json,
            )
        # Errors of files are WriteErrors, so this is an error of standard output.
        if error.errno not in _FULL or os.environ.get("IMUCAL_DEBUG"):
            return _explain(error, as_json=as_json)
        _drop(sys.stdout)
        return _explain(WriteError(f"can't write to standard output: {error.strerror}; free some space"))
    except (Exception, KeyboardInterrupt) as error:
        if os.environ.get("IMUCAL_DEBUG"):
            raise
        return _explain(error, as_json=as_json)
    return code if isinstance(code, int) else 0


def _drop(stream: TextIO) -> None:
    """Discard the buffered output of a stream, so that Python prints no error at its exit."""
    with suppress(OSError, ValueError):
        stream.flush()
    with suppress(OSError, ValueError):
        _to_null(stream.fileno())


def _to_null(descriptor: int) -> None:
    """Redirect a file descriptor to the null device."""
    device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(device, descriptor)
    os.close(device)


def _explain(error: BaseException, *, as_json: bool = False) -> int:
    """Print an error, with --json also as JSON; return the exit code."""
    match error:
        case click.ClickException():
            text = io.StringIO()
            error.show(text)
            message, code = text.getvalue().rstrip(), error.exit_code
        case ImucalError():
            message, code = f"Error: {message_of(error)}", error.exit_code
        case click.Abort() | KeyboardInterrupt():
            message, code = "Interrupted; no file is incomplete.", 130
        case MemoryError():
            message, code = (
                "Error: out of memory; read a part of the log (--skip, --take)",
                DataError.exit_code,
            )
        case _:
            what = f"{type(error).__name__}: {error}"
            message = f"Error: internal error ({what}). Please report it; IMUCAL_DEBUG=1 shows where."
            code = 70
    click.echo(printable(message), err=True)
    if as_json and not getattr(error, "printed", False):
        # Programs parse standard output; it must not contain an error after the results.
        document = {
            "schema": "imucal/error/2",
            "error": {
                "type": type(error).__name__,
                "message": message.removeprefix("Error: "),
                **fields_of(error),
                "exit_code": code,
            },
        }
        try:
            click.echo(printable_json(json.dumps(document, indent=2)))
        except OSError:
            # The message is on standard error.
            _drop(sys.stdout)
    return code


#: Name of this project in the package index.
OURS = "imucal-noise"
#: Another project with a package of the same name: pip installs both into one folder, where one overwrites
#: files of the other.
OTHER = "imucal"


def _version_lines() -> str:
    """Return version, folder and Python version; warn if files of two distributions may be mixed."""
    from importlib.metadata import PackageNotFoundError, version

    folder = Path(__file__).resolve().parent.parent
    lines = [f"imucal {__version__} ({OURS}) in {folder}, Python {platform.python_version()}"]
    try:
        other = version(OTHER)
    except PackageNotFoundError:
        return lines[0]
    lines += [
        f"The distribution {OTHER} {other}, of another project, is installed too:",
        "its files and imucal's are in one folder.",
        f"Type: pip uninstall {OTHER} {OURS}, and install {OURS} again.",
    ]
    return "\n".join(lines)
