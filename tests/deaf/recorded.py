"""What a gateway writes to its controller, message by message, in virtual time."""

import asyncio
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from gateway.model.frames import Frame
from gateway.robot.protocol import BatchReport, Wire
from tests.deaf.minute import Message
from tests.support.robot import MS, Robot


class Written(NamedTuple):
    """A transfer as it was recorded."""

    at_ns: int
    data: bytes
    repeat: bool
    """Whether it is part of a repeated run of Stops."""


class _Recorded(Robot):
    def __init__(self) -> None:
        self.log: list[Written] = []
        super().__init__({"spi": {"framing": "length-prefixed"}})

    def wire(self) -> Wire:
        bus, take, repeats = super().wire(), self.controller.take, False
        write = bus.write

        def marked(frames: Sequence[Frame], *, preamble: bool = False) -> BatchReport:
            nonlocal repeats
            repeats = preamble
            return write(frames, preamble=preamble)

        def recorded(data: bytes) -> None:
            self.log.append(Written(self.now_ns(), data, repeats and len(data) > 1))
            take(data)

        bus.write, self.controller.take = marked, recorded  # type: ignore[method-assign]
        return bus


async def recorded(messages: Iterable[Message], until_ms: float) -> list[Written]:
    """All transfers up to this time of a gateway that starts at 0 and receives these."""
    robot = _Recorded()
    begun_ns = robot.now_ns()
    robot.conductor.start()
    for message in messages:
        await asyncio.sleep(max(0.0, (begun_ns + message.at_ms * MS - robot.now_ns()) / 1e9))
        robot.put(message.key, message.payload)
    await asyncio.sleep((begun_ns + until_ms * MS - robot.now_ns()) / 1e9)
    robot.conductor.close()
    return [each._replace(at_ns=each.at_ns - begun_ns) for each in robot.log]
