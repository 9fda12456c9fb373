"""The lease in the model check: what may be asked of it, how it is copied, and what of it tells states apart."""

from collections.abc import Iterator, Sequence

from gateway.robot.core.events import Do, Event, LeaseRequest
from gateway.robot.core.lease import Lease
from tests.support.history import cloned
from tests.support.lease_history import LeaseHistory


def copied_lease(lease: Lease) -> Lease:
    """A copy that shares nothing that changes."""
    return cloned(lease, _askers=dict(lease._askers), changes=lease.changes.copy())


def lease_key(lease: Lease, now_ns: int) -> tuple[object, ...]:
    """What of it can still matter; one token is as good as another."""
    left_ns = None if lease.due_ns is None else lease.due_ns - now_ns
    return lease.holder, lease._token is not None, left_ns, lease.guards, tuple(lease._askers)


def tokens(drivers: Sequence[str], lease: LeaseHistory) -> Iterator[tuple[str, str | None]]:
    """What a command may carry: no token, that of the lease, or that of a lease that has ended."""
    yield "", None
    if drivers and lease.token is not None:
        yield " of the holder", lease.token
    if drivers and lease.old_token is not None:
        yield " of a former holder", lease.old_token


def lease_requests(drivers: Sequence[str], number: int, lease: LeaseHistory) -> Iterator[tuple[str, Event]]:
    """Everything that each of them may want of it; a new token is one that nobody had."""
    fresh = f"token {number}"
    for name in drivers:
        for do in (Do.ACQUIRE, Do.ASK, Do.TAKE):
            yield f"{name} wants to {do}", LeaseRequest(do, name, fresh_token=fresh)
    for whose, token in tokens(drivers, lease):
        if token is not None:
            yield f"renewal{whose}", LeaseRequest(Do.RENEW, token=token)
            yield f"release{whose}", LeaseRequest(Do.RELEASE, token=token)
            yield f"handover{whose}", LeaseRequest(Do.RELEASE, token=token, to=drivers[-1])
