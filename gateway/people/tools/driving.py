"""The lease from a shell: `lease`, `send --hold`, and other commands that drive."""

import shlex
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Final

from gateway.errors import LeaseError, UnansweredError
from gateway.people.client.blocking import Client
from gateway.people.terminal import agrees, hint, on_end_signals, say, this_command
from gateway.people.tools import kept_lease, reach
from gateway.people.tools.reach import Connection
from gateway.text import visible
from schemas.lease import LeaseAck
from schemas.telemetry import Ack, GatewayState, LeaseReport, Reason

connection = partial(reach.connection, source="hexapod-gateway lease")


_UNVERIFIED: Final = " (a name that nobody has verified)"


def status(connect: Connection) -> int:
    """Print who drives. Returns the exit code."""
    with connect() as client:
        lease = client.state().lease
    say(_who(lease))
    if lease.asked_by is not None:
        say(f"{lease.asked_by} asks for it")
    return 0


def take(connect: Connection, *, agreed: bool, for_s: float) -> int:
    """Take the lease by force, after a question. Returns the exit code."""
    with connect() as client:
        state = client.state()
    if not agreed and state.lease.holder is not None and not _agree(state):
        say("nothing is done")
        return 1
    return hold(connect, for_s=for_s, take=True)


def hold(connect: Connection, *, for_s: float, take: bool = False, wait_s: float = 0.0) -> int:
    """Hold it until Ctrl-C, for so long, or until it is lost or released from elsewhere. Returns the exit code."""
    ended = threading.Event()
    with connect() as client, on_end_signals(ended.set):
        if wait_s and (holder := client.state().lease.holder) is not None:
            hint(f"{holder} drives, and is asked; waiting for up to {wait_s:g} s.")
        held = kept_lease.acquired(
            client, take=take, wait_s=wait_s, on_lost=lambda _: ended.set(), on_asked=_tell_of_asker
        )
        try:
            with held as lease:
                say(f"{lease.holder} drives{_UNVERIFIED if not lease.verified else ''}")
                until = "" if for_s else " Ctrl-C releases it."
                hint(f"Until it is released, `send` and `reset` of this user drive.{until}")
                ended.wait(for_s or None)
                released = not kept_lease.is_kept(client, lease.token or "")
        except LeaseError as error:
            return not_acquired(client, error)
    if lease.lost is None or released:
        say("released" if lease.lost is None else "released elsewhere")
        return 0
    say(f"lost: {lease.lost.detail}")
    return 1


def release(connect: Connection, to: str | None) -> int:
    """Release the lease that this user holds on this machine. Returns the exit code."""
    with connect() as client:
        token = kept_lease.token_of(client)
        if token is None:
            say("rejected: no_lease: this user holds no lease of that robot on this machine")
            return 1
        if to is None:
            kept_lease.forget(client, token)  # first, so that the command that holds it knows why it ended
        ack = client.lease_requests.release(token, to)
        if not ack.accepted:
            return rejected(ack)
        kept_lease.forget(client, token)
        say("released" if to is None else f"handed over to {to}")
        return 0


@contextmanager
def drives(client: Client, hold_s: float, *, moves: bool) -> Iterator[dict[str, str]]:
    """Yields what a command adds to its payload: the token that this user keeps, or nothing (a Stop).

    With `hold_s` it acquires the lease meanwhile, where this user keeps none. Raises LeaseError where it is held.
    """
    if not moves:
        yield {}
        return
    token = None
    with suppress(UnansweredError):  # a gateway that knows of no lease
        token = kept_lease.token_of(client)
    if token is not None or not hold_s:
        yield {} if token is None else {"lease": token}
        return
    lease = client.lease(source=kept_lease.me())
    try:
        lease.acquire()
    except UnansweredError:
        pass
    except LeaseError as error:
        if error.reason == Reason.LEASE_HELD:
            raise
        if error.reason == Reason.LEASE_DENIED:  # and not by an older gateway, which does not know the request
            hint(f"It is sent without the lease: {error.detail}")
    try:
        yield {}
    finally:
        lease.release()


def not_acquired(client: Client, error: LeaseError) -> int:
    """Print why the lease was not acquired, and what can be done. Returns the exit code."""
    if error.reason == Reason.LEASE_HELD and kept_lease.token_of(client) is not None:
        say("rejected: lease_held: this user holds it already, in another terminal")
        hint(f"`{this_command()} lease release` ends that.")
        return 1
    return rejected(error)


def rejected(error: LeaseError | Ack | LeaseAck) -> int:
    """Print why it was rejected, and what can be done. Returns the exit code."""
    say(f"rejected: {error.reason}: {error.detail}")
    if error.reason in (Reason.NOT_HOLDER, Reason.LEASE_HELD):
        hint(
            f"`{this_command()} lease ask` asks for it; `lease take` takes it by force, and stops all legs first; "
            "`stop` and `estop` work for everybody."
        )
    elif error.reason == Reason.NO_LEASE:
        hint(f"This robot wants to know who drives: `{this_command()} lease acquire`, or `send … --hold S`.")
    return 1


def _who(lease: LeaseReport) -> str:
    if lease.holder is None:
        return "nobody drives"
    verified = "" if lease.verified else _UNVERIFIED
    holder = visible(lease.holder)
    if lease.held_s is None:
        return f"handed over to {holder}{verified}, who has not acquired it yet"
    return f"{holder} drives{verified}, for {lease.held_s:.0f} s"


def _agree(state: GatewayState) -> bool:
    running = sum(any(servo.running for servo in leg.servos) for leg in state.legs)
    legs = "no leg runs" if not running else f"{running} leg{'' if running == 1 else 's'} running"
    who = f"{_who(state.lease)} ({legs})"
    if sys.stdin.isatty():
        hint(f"{_who(state.lease)}; {legs}. Taking it by force stops all six legs first.")
    return agrees("Take it?", nobody=f"{who}: say --yes to take it without being asked")


def _tell_of_asker(who: str) -> None:
    to = shlex.quote(visible(who))
    hint(f"{who} asks for the lease: `{this_command()} lease release --to {to}` hands it over.")
