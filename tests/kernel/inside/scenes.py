"""All scenes: what each shows, and in which boot."""

import struct
from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

from gateway.model.frames import Framing
from tests.kernel.inside import batches, camera, power, service, shipped


class Scene(NamedTuple):
    """`play` returns what it found, in a few words, or raises AssertionError with what it missed."""

    shows: str
    play: Callable[[], str]
    options: str = ""
    """Options of the kernel's command line."""


SCENES: Final = {
    "batch-plain": Scene(
        "plain: a batch's bytes, chip select around each transfer, the pauses", lambda: batches.edges(Framing.PLAIN)
    ),
    "batch-length-prefixed": Scene(
        "length-prefixed: the same, behind a preamble", lambda: batches.edges(Framing.LENGTH_PREFIXED)
    ),
    "atomic": Scene("no transfer of two other writers comes into a batch", batches.atomic),
    "killed": Scene("a program that is killed in its batch finishes it", batches.killed),
    "error": Scene("a transfer fails at once: all six Stops leave", batches.fails_at_once),
    "lost": Scene("Linux gives up on a transfer: all six Stops leave", batches.lost),
    "hang": Scene("a transfer hangs in the driver: nobody is killed, and nothing overtakes it", batches.hangs),
    "estop-plain": Scene("plain: an emergency stop of a service", lambda: service.emergency_stop(Framing.PLAIN)),
    "estop-length-prefixed": Scene(
        "length-prefixed: an emergency stop of a service", lambda: service.emergency_stop(Framing.LENGTH_PREFIXED)
    ),
    "lost-zeros": Scene("zeros are lost and frames pass: six Stops soon", service.lost_zeros),
    **{
        name: Scene(f"another program sets {what}: no Stop leaves with it", partial(service.meddled, request, value))
        for name, what, request, value in (
            ("other-speed-fast", "20 MHz", service.WRITE_SPEED, struct.pack("=I", 20_000_000)),
            ("other-speed-slow", "10 kHz", service.WRITE_SPEED, struct.pack("=I", 10_000)),
            ("other-mode", "mode 3", service.WRITE_MODE, b"\x03"),
        )
    },
    "unbound": Scene("the device goes while it is written, and returns: six Stops", service.unbound),
    "power-estop": Scene("socketcan: an emergency stop takes the supply, and is confirmed", power.estop),
    "power-others": Scene("socketcan: masks of other programs on this computer, and stop-servos", power.others),
    "power-down": Scene("socketcan: the interface goes while legs run, and returns", power.down),
    "camera": Scene(
        "µStreamer on a camera of the kernel: pictures with their age, and none while it hangs", camera.streams
    ),
    "bufsiz": Scene(
        "with a buffer of 512 bytes, shorter lists and the same bytes", batches.small_buffer, "spidev.bufsiz=512"
    ),
}
ARM64: Final = {
    **{
        name: SCENES[name]
        for name in ("batch-plain", "batch-length-prefixed", "atomic", "killed", "error", "lost", "hang")
    },
    "installed": Scene("the package is installed, and nothing runs yet", shipped.installed),
    "setup": Scene("setup starts the service: six Stops come first", shipped.set_up),
    "check": Scene("check finds nothing wrong", shipped.checked),
    "first-contact": Scene("check --move moves one servo", shipped.first_contact),
    "check-stops": Scene("check --stops: each step passes", shipped.proven),
    "sigkill": Scene("an emergency stop outlives kill -9, and Stops come from outside", shipped.killed),
    "sigstop": Scene("a process that hangs is ended, and Stops come from outside", shipped.hung),
    "upgrade": Scene("an upgrade and the way back keep an emergency stop", shipped.upgraded),
    "end": Scene("systemctl stop: six Stops", shipped.ended),
    "removal": Scene("the package is removed", shipped.removed),
}
"""On a machine for arm64, in this order."""
ALL: Final = SCENES | ARM64
