"""The payload of `hexapod/state`, which makes a GatewayState together with `hexapod/config`.

A state must be short for a reader with little memory: zenoh-pico with its defaults received nothing of 4 074 bytes. So
rare changes are on `hexapod/config`, legs are columns, and texts are cut if they are too long together.
"""

from bisect import bisect_left
from collections.abc import Iterator
from typing import Annotated, Final, TypeVar

from pydantic import Field

from schemas.config import ConfigReport
from schemas.gateway_state import ChangingState, GatewayState, LegReport, ServoReport
from schemas.report import CUT, Report, Six
from schemas.robot import JOINTS, LEGS
from schemas.words import AnyWatchdogState

MAX_STATE_BYTES: Final = 2048
MOST_BUTTONS: Final = 16
"""Names of stop buttons; `buttons.alive` counts all."""
_CUTS: Final = ((400, 64), (200, 64), (100, 64), (48, 64), (24, 64), (16, 32), (12, 16), (8, 8), (4, 4), (1, 1))
"""Most characters of a text, and of a sender's name. The first pair that fits is used; the last always fits."""

T = TypeVar("T", str, str | None)

Angle = float | None
Angles = tuple[Angle, Angle, Angle]
_Place = Annotated[int, Field(ge=0, lt=len(LEGS))] | None


class LegsReport(Report):
    """All legs, a column for each value: its first entry is leg 1's."""

    watchdog: Annotated[Six[AnyWatchdogState], Field(description="of legs 1 to 6")]
    age_ms: Annotated[Six[float | None], Field(description="since an accepted start or set; null: none")]
    angles_deg: Annotated[Six[Angles], Field(description="joints 1 to 3 as last written; null: does not run")]
    targets_deg: Annotated[Six[Angles] | None, Field(description="their targets; null: as `angles_deg`")] = None
    source: Annotated[Six[_Place], Field(description="index into `sources`: whose command is in force")]


class StateReport(ChangingState):
    """The payload of `hexapod/state`: at most 2 048 bytes. A text that was cut ends with `…`."""

    legs: LegsReport
    sources: Annotated[
        tuple[str, ...], Field(max_length=len(LEGS), description="senders of the commands in force")
    ] = ()
    source_ids: Annotated[
        tuple[str | None, ...], Field(max_length=len(LEGS), description="their Zenoh ids; null: not in the command")
    ] = ()

    def fitted(self) -> "StateReport":
        """Return the report, with its texts cut if it is too long."""
        if _fits(self):
            return self
        level = bisect_left(_CUTS, True, hi=len(_CUTS) - 1, key=lambda most: _fits(self.cut(*most)))
        return self.cut(*_CUTS[level])

    def cut(self, most: int, most_source: int) -> "StateReport":
        """Return the report with at most `most` characters in each text, and `most_source` in each sender's name."""
        lease, buttons, power = self.lease, self.buttons, self.power
        names = {"holder": _cut(lease.holder, most_source), "asked_by": _cut(lease.asked_by, most_source)}
        buttons_names = tuple(_cut(each, most) for each in buttons.names[:MOST_BUTTONS])
        return self.model_copy(
            update={
                "sources": tuple(_cut(each, most_source) for each in self.sources),
                "estop_source": _cut(self.estop_source, most_source),
                "estop_fault": _cut(self.estop_fault, most),
                "incident": _cut(self.incident, most),
                "lease": lease.model_copy(update=names),
                "buttons": buttons.model_copy(update={"names": buttons_names}),
                "power": power and power.model_copy(update={"interface": _cut(power.interface, most)}),
            }
        )


def _fits(report: StateReport) -> bool:
    return len(report.model_dump_json().encode()) <= MAX_STATE_BYTES


def joined(state: StateReport, config: ConfigReport) -> GatewayState:
    """Return the state and its configuration as one report, for programs."""
    parts = "spi", "watchdog", "buttons"  # they have settings and counters
    both = {name: {**dict(getattr(config, name)), **dict(getattr(state, name))} for name in parts}
    return GatewayState.model_validate({**dict(config), **dict(state), **both, "legs": tuple(_legs(state))})


def _legs(state: StateReport) -> Iterator[LegReport]:
    legs = state.legs
    targets = legs.angles_deg if legs.targets_deg is None else legs.targets_deg
    for row, leg in enumerate(LEGS):
        place = legs.source[row]
        first, second, third = (
            ServoReport(id=10 * leg + joint, running=at is not None, angle_deg=at, target_deg=target)
            for joint, at, target in zip(JOINTS, legs.angles_deg[row], targets[row], strict=True)
        )
        yield LegReport(
            leg=leg,
            watchdog=legs.watchdog[row],
            age_ms=legs.age_ms[row],
            servos=(first, second, third),
            source=_at(state.sources, place),
            source_id=_at(state.source_ids, place),
        )


def _at(column: tuple[T, ...], place: int | None) -> T | None:
    return None if place is None or place >= len(column) else column[place]


def _cut(text: T, most: int) -> T:
    return text if text is None or len(text) <= most else text[: most - 1] + CUT
