"""The lease of commands that drive: `send --hold`, `check --move`; and what a person can do without it."""

from collections.abc import Iterator
from contextlib import contextmanager

from gateway.errors import LeaseError, UnansweredError
from gateway.own_command import command
from gateway.people.client.blocking import Client
from gateway.people.commands.reach import me
from gateway.people.terminal import hint, say
from schemas.lease import LeaseAck
from schemas.telemetry import Ack, Reason


@contextmanager
def drives(client: Client, hold_s: float, *, moves: bool) -> Iterator[None]:
    """Hold the lease for the time of a `with`, if something moves for `hold_s`.

    Raises LeaseError where somebody else holds it.
    """
    if not moves or not hold_s:
        yield
        return
    lease = client.lease(source=me())
    try:
        lease.acquire()
    except UnansweredError:  # a gateway that knows of no lease
        pass
    except LeaseError as error:
        if error.reason == Reason.LEASE_HELD:
            raise
        if error.reason == Reason.LEASE_DENIED:  # and not by an older gateway, which does not know the request
            hint(f"It is sent without the lease: {error.detail}")
    try:
        yield
    finally:
        lease.release()


def rejected(error: LeaseError | Ack | LeaseAck) -> int:
    """Print why it was rejected, and what can be done. Returns the exit code."""
    say(f"rejected: {error.reason}: {error.detail}")
    if error.reason in (Reason.NOT_HOLDER, Reason.LEASE_HELD):
        hint(
            f"Wait until it is free (`{command('status --follow')}`), or ask for it or take it on the console's "
            "page. Stops work for everybody."
        )
    elif error.reason == Reason.NO_LEASE:
        hint(f"This robot wants to know who drives: `{command('send … --hold S')}` holds the lease meanwhile.")
    return 1
