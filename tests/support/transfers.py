"""What is to be seen on the wire, written apart from the bus that brings it there."""

from gateway.model.frames import Frame, Framing


def on_wire(framing: Framing, *frames: Frame | bytes) -> list[bytes]:
    """Return the transfers that carry these frames, in order: where the framing wants it, each behind its length."""
    written = [frame if isinstance(frame, bytes) else frame.data for frame in frames]
    announced = framing is Framing.LENGTH_PREFIXED
    return [data for frame in written for data in ((bytes((len(frame),)), frame) if announced else (frame,))]


def preamble_of(framing: Framing) -> list[bytes]:
    """Return the zeros that synchronise a controller, each in a transfer of its own; none for PLAIN."""
    return [b"\0"] * 16 if framing is Framing.LENGTH_PREFIXED else []
