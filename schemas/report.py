"""The base of all payloads that go out."""

from collections.abc import Iterator
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

T = TypeVar("T")
Count = Annotated[int, Field(ge=0)]
Six = tuple[T, T, T, T, T, T]
"""A value for each leg, 1 to 6."""
CUT = "…"
"""Ends a text that was cut."""


class Report(BaseModel):
    """Frozen and open: fields are only ever added, and readers ignore unknown ones.

    A reader that rejected unknown fields would show NOT STOPPED after a successful stop. A report's validator is made
    at its first use, so the service writes its first Stops before.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)


class Sparse(Report):
    """A report whose null fields are left out of its JSON and its repr."""

    @model_serializer(mode="wrap")
    def _without_nulls(self, handler: SerializerFunctionWrapHandler) -> dict[str, object]:
        return {name: value for name, value in handler(self).items() if value is not None}

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        return ((name, value) for name, value in super().__repr_args__() if value is not None)
