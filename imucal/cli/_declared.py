"""How a command says what it takes: a function whose keyword arguments have their options for defaults."""

import functools
import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn

import click

__all__ = ["argument", "declared", "flag", "misuse", "option", "shown", "together"]


@dataclass(frozen=True, slots=True, eq=False)
class _Declared:
    """A parameter of a command, as the default of the argument that takes it."""

    kind: type[click.Parameter]
    names: str
    attributes: dict[str, Any]

    def parameters(self, name: str) -> Iterator[click.Parameter]:
        yield self.kind([*self.names.split(), name], **self.attributes)

    def value(self, name: str, values: dict[str, Any]) -> object:
        return values[name]


@dataclass(frozen=True, slots=True, eq=False)
class _Together:
    """Parameters of a command that make one value; each may be changed for a command."""

    make: Callable[..., Any]
    declared: dict[str, Any]
    change: Callable[[click.Parameter], None] = lambda _: None

    def parameters(self, _: str) -> Iterator[click.Parameter]:
        for name, one in self.declared.items():
            for parameter in one.parameters(name):
                self.change(parameter)
                yield parameter

    def value(self, _: str, values: dict[str, Any]) -> object:
        return self.make(**{name: one.value(name, values) for name, one in self.declared.items()})


def declared(epilog: str) -> Callable[[Callable[..., None]], click.Command]:
    """Make a click command of a function: the defaults of its arguments declare the parameters, in order."""

    def made(function: Callable[..., None]) -> click.Command:
        arguments = inspect.signature(function).parameters
        whole = _Together(function, {name: argument.default for name, argument in arguments.items()})

        @functools.wraps(function)
        def call(**values: Any) -> object:  # noqa: ANN401
            return whole.value("", values)

        return click.command(params=list(whole.parameters("")), epilog=epilog)(call)

    return made


def option(names: str, text: str, kind: object = None, metavar: str | None = None, **more: Any) -> Any:  # noqa: ANN401
    """Declare an option: its help, its type, what stands for its value in the help, and more of click's."""
    return _Declared(click.Option, names, {"help": text, "type": kind, "metavar": metavar, **more})


def shown(
    names: str,
    default: object,
    text: str,
    kind: object = None,
    metavar: str | None = None,
    **more: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Declare an option whose default stands in its help."""
    return option(names, text, kind, metavar, default=default, show_default=True, **more)


def flag(names: str, text: str) -> Any:  # noqa: ANN401
    """Declare an option that is given or not."""
    return option(names, text, is_flag=True)


def together(make: Callable[..., Any], declared: dict[str, Any]) -> Any:  # noqa: ANN401
    """Declare what a function makes of several parameters."""
    return _Together(make, declared)


def argument(metavar: str | None, kind: object = None, **more: Any) -> Any:  # noqa: ANN401
    """Declare an argument of a command."""
    return _Declared(click.Argument, "", {"metavar": metavar, "type": kind, **more})


def misuse(text: object) -> NoReturn:
    """Raise what ends a command with exit code 2: what was typed can't be meant."""
    raise click.UsageError(str(text))
