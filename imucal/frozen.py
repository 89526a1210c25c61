"""Values of the package: what has been found does not change, and its parts are given by name."""

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

__all__ = ["frozen", "frozen_alone"]

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def frozen(cls: type[T]) -> type[T]:
    """Make a class a dataclass with slots whose fields are given by name and never set again."""
    return dataclass(frozen=True, slots=True, kw_only=True)(cls)


@dataclass_transform(eq_default=False, frozen_default=True, kw_only_default=True)
def frozen_alone(cls: type[T]) -> type[T]:
    """Do the same for a class that holds arrays, which can't be compared: one is equal to itself alone."""
    return dataclass(frozen=True, slots=True, kw_only=True, eq=False)(cls)
