"""Plain values that are made for each message."""

from dataclasses import dataclass
from typing import TypeVar, dataclass_transform

T = TypeVar("T")


@dataclass_transform(frozen_default=True)
def value(cls: type[T]) -> type[T]:
    """Make a dataclass that is frozen for the type checker only: freezing at run time takes four times as long."""
    return dataclass(slots=True, unsafe_hash=True)(cls)
