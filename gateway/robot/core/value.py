"""Plain values: what passes between the parts, made for each message."""

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def value(cls: type[T]) -> type[T]:
    """A dataclass that is frozen for the type checker only: one that is frozen at run time takes four times as long."""
    return dataclass(slots=True, unsafe_hash=True)(cls)
