"""Declare commands as functions: the defaults of the keyword arguments declare the options."""

import functools
import inspect
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn

import click

#: Title in ``--help`` -> names of the parameters below it; others are below "Options".
_GROUPS = {
    "Output": "out as_json opened formats figure no_html no_report no_files datasheet npz junit github apply "
    "quiet verbose",
    "Which samples": "topic skip_s take_s rests time rate_hz columns message_definition join strict",
    "Units": "time_unit gyro_unit accel_unit gyro_scale accel_scale",
    "Model": "model level method",
    "Advanced": "taus edf no_clean criterion weights segments second_opinion bins",
}
#: Their help only mentions the options for logs.
_OF_REPORTS = {"export", "check", "drift", "plan", "compare"}
#: A range such as ``[x>=1]``, which click adds to the help; the error message contains it.
_RANGE = re.compile(r"  \[{0}\]|; {0}(?=\])".format(r"(?:[^\s;[]+<=?)?x(?:[<>]=?[^\s;\]]+)?"))


class _Option(click.Option):
    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        record = super().get_help_record(ctx)
        return record and (record[0], _RANGE.sub("", record[1]))


class _Command(click.Command):
    """A command whose ``--help`` lists its options in groups."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        elsewhere = ("Which samples", "Units") if ctx.info_name in _OF_REPORTS else ()
        groups = self._groups(ctx, moved={"rate_hz"} if elsewhere else set())  # a model needs a rate
        for title, records in groups.items():
            if title not in elsewhere:
                with formatter.section(title):
                    formatter.write_dl(records, col_max=formatter.width // 3)
        if groups.keys() & set(elsewhere):
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text("For a log, the options of 'imucal fit' for samples and units work too.")

    def _groups(self, ctx: click.Context, moved: set[str]) -> dict[str, list[tuple[str, str]]]:
        """Return title -> help of its options, in the order of `_GROUPS`; `moved` are below "Options"."""
        titles = {name: title for title, names in _GROUPS.items() for name in names.split()}
        order = {name: place for place, name in enumerate([*titles, "help"])}
        groups: dict[str, list[tuple[str, str]]] = {title: [] for title in ("Options", *_GROUPS)}
        for one in sorted(self.get_params(ctx), key=lambda one: order.get(one.name or "", -1)):
            if isinstance(one, click.Option) and (record := one.get_help_record(ctx)):
                title = "Options" if one.name in moved else titles.get(one.name or "", "Options")
                groups[title].append(record)
        return {title: records for title, records in groups.items() if records}


@dataclass(frozen=True, slots=True, eq=False)
class _Declared:
    """A parameter of a command, declared as the default of an argument."""

    kind: type[click.Parameter]
    names: str
    attributes: dict[str, Any]

    def parameters(self, name: str) -> Iterator[click.Parameter]:
        yield self.kind([*self.names.split(), name.lstrip("_")], **self.attributes)

    def value(self, name: str, values: dict[str, Any]) -> object:
        return values[name]


@dataclass(frozen=True, slots=True, eq=False)
class _Together:
    """Parameters of a command from which `make` makes one value; `change` adapts them to the command."""

    make: Callable[..., Any]
    declared: dict[str, Any]
    change: Callable[[click.Parameter], None] = lambda _: None

    def parameters(self, _: str) -> Iterator[click.Parameter]:
        for name, one in self.declared.items():
            for parameter in one.parameters(name):
                self.change(parameter)
                yield parameter

    def value(self, _: str, values: dict[str, Any]) -> object:
        passed = {name: one for name, one in self.declared.items() if not name.startswith("_")}
        return self.make(**{name: one.value(name, values) for name, one in passed.items()})


def declared(function: Callable[..., None]) -> click.Command:
    """Make a click command from a function: the defaults of its arguments declare the parameters, in order.

    The docstring is the help. From the first line that ends in two colons, it is printed below the options
    without wrapping. Arguments whose names start with an underscore are not passed; use `is_set`.
    """
    arguments = inspect.signature(function).parameters
    whole = _Together(function, {name: argument.default for name, argument in arguments.items()})
    text = inspect.cleandoc(function.__doc__ or "")
    first = re.search("^.*::$", text, re.MULTILINE)
    start = first.start() if first else len(text)
    below = "\n\n".join(f"\b\n{part}" for part in text[start:].replace("::\n", ":\n").split("\n\n"))

    @functools.wraps(function)
    def call(**values: Any) -> object:  # noqa: ANN401
        return whole.value("", values)

    return click.command(cls=_Command, params=list(whole.parameters("")), help=text[:start], epilog=below)(
        call
    )


def option(declaration: str, kind: object = None, **more: Any) -> Any:  # noqa: ANN401
    """Declare an option by its line of help, such as ``-o --out DIR=fleet  Folder of it.``.

    The line contains the names, the metavar, optionally an equals sign and the default for the help, then two
    spaces and the sentence. `kind` is click's type, `more` are other arguments of click.
    """
    head, _, text = declaration.partition("  ")
    head, equals, default = head.partition("=")
    words = head.split()
    names = [word for word in words if word.startswith("-")]
    metavar = words[-1] if len(names) < len(words) else None
    shown = {"default": default, "show_default": True} if equals else {}
    return _Declared(
        _Option, " ".join(names), {"help": text, "type": kind, "metavar": metavar, **shown, **more}
    )


def flag(declaration: str, **more: Any) -> Any:  # noqa: ANN401
    """Declare an option without a value."""
    return option(declaration, is_flag=True, **more)


def together(make: Callable[..., Any], declared: dict[str, Any]) -> Any:  # noqa: ANN401
    """Declare a value that a function makes from several parameters."""
    return _Together(make, declared)


def argument(metavar: str | None, kind: object = None, **more: Any) -> Any:  # noqa: ANN401
    """Declare an argument of a command."""
    return _Declared(click.Argument, "", {"metavar": metavar, "type": kind, **more})


def is_set(name: str) -> bool:
    """Return whether the running command has a flag, such as quiet; False if no command runs."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.params.get(name))


def misuse(text: object, *options: str) -> NoReturn:
    """Raise a usage error, exit code 2, for the command or for some `options`."""
    raise click.BadParameter(str(text), param_hint=options) if options else click.UsageError(str(text))
