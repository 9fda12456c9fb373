"""All scenes: what each shows, in which boot."""

from collections.abc import Callable
from typing import Final, NamedTuple

from gateway.robot.protocol.framing import Framing
from tests.kernel.inside import batches


class Scene(NamedTuple):
    """`play` returns what it found, in a few words, or raises AssertionError with what it missed."""

    shows: str
    play: Callable[[], str]
    options: str = ""
    """Of the kernel."""


SCENES: Final = {
    "batch-plain": Scene(
        "plain: a batch's bytes, an edge around each transfer, the pauses",
        lambda: batches.edges(Framing.PLAIN),
    ),
    "batch-length-prefixed": Scene(
        "length-prefixed: the same, behind a preamble", lambda: batches.edges(Framing.LENGTH_PREFIXED)
    ),
    "atomic": Scene("no transfer of two other writers comes into a batch", batches.atomic),
    "killed": Scene("a program that is killed in its batch finishes it", batches.killed),
    "bufsiz": Scene("with a buffer of 512 bytes, shorter lists with the same bytes", batches.small_buffer,
                    "spidev.bufsiz=512"),
}  # fmt: skip
