"""Reaching the gateway from a command: where nobody answers, which step of the way fails and what to do.

A program's own `Client` raises at once when a question is not answered; a command ends then, so it has time to look.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

from gateway.errors import UnansweredError, ZenohError
from gateway.people.client.blocking import DEFAULT_ENDPOINT, Client

Connection = Callable[[], AbstractContextManager[Client]]


def connection(connect: str | None, zenoh_config: Path | None, timeout_s: float, *, source: str) -> Connection:
    """How to reach the gateway: the endpoint given, or the file's, or this machine's.

    Where that fails, also for a question inside it, the ZenohError has a line for each endpoint, with the step.
    """
    if connect is None and zenoh_config is None:
        connect = DEFAULT_ENDPOINT
    return partial(_connected, connect, zenoh_config, timeout_s, source)


@contextmanager
def _connected(connect: str | None, zenoh_config: Path | None, timeout_s: float, source: str) -> Iterator[Client]:
    with Client(connect, zenoh_config=zenoh_config, source=source, timeout_s=timeout_s) as client:
        try:
            yield client
        except UnansweredError as error:
            from gateway.people.tools import why  # only now: no emergency stop should wait for what it loads

            raise ZenohError("\n".join(why.unanswered(client, connect, zenoh_config))) from error
