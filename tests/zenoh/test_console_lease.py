"""Who drives, of several pages: the lease is one WebSocket's, lives by that page's own requests, and ends with it."""

import itertools
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any, Final

import pytest

from tests.support.console_process import TRIES, Console, Page, SignedIn
from tests.support.fixtures import console_fixture, gateway_fixture, patient, session_fixture

LEG_3: Final = "hexapod/leg/3/cmd"
START: Final = {"servos": [{"op": "start", "angle_deg": 90}] * 3}
STOP: Final = {"servos": [{"op": "stop"}] * 3}
TTL_MS: Final = 3000


gateway = gateway_fixture(patient(5000, lease={"ttl_ms": TTL_MS}))
console = console_fixture()
session = session_fixture()


@pytest.fixture
def anna(console: Console, session: SignedIn) -> Iterator[Page]:
    """A page, while nobody drives."""
    with console.page(session) as page:
        page.state(lambda state: state["lease"]["holder"] is None)
        yield page


@pytest.fixture
def bert(console: Console, session: SignedIn) -> Iterator[Page]:
    with console.page(session) as page:
        yield page


NUMBERS: Final = itertools.count(1000)


def lease(page: Page, do: str) -> dict[str, Any]:
    """Ask for something about the lease, again where a busy gateway did not answer in time; the answer."""
    for number in itertools.islice(NUMBERS, TRIES):
        page.send(type="lease", id=number, do=do)
        answer = page.answer("lease", number)
        if answer["accepted"] is not None:
            break
    return answer


def test_the_token_stays_in_the_server(anna: Page, bert: Page) -> None:
    """No message to any page has it: 32 hex digits in a row."""
    assert lease(anna, "acquire")["mine"]
    assert anna.ask(LEG_3, START)["ack"]["accepted"]
    assert anna.ask(LEG_3, STOP)["ack"]["accepted"]
    assert lease(anna, "renew")["mine"]
    assert not lease(anna, "release")["mine"]
    bert.state()
    heard = anna.heard + bert.heard
    assert any('"mine":true' in text for text in heard)
    assert not [text for text in heard if re.search("[0-9a-f]{32}", text)]


def test_only_the_page_itself_renews_it(anna: Page, bert: Page) -> None:
    """A page that is frozen has an open socket, and loses the lease all the same."""
    began = datetime.now(UTC)
    assert lease(anna, "acquire")["mine"]
    for _ in range(3):
        bert.state()
        assert lease(anna, "renew")["mine"]
    bert.event("lease_expired", since=began)
    for _ in range(10):  # a second later it is over by the console's own clock, too
        bert.state()
    lost = lease(anna, "renew")
    assert (lost["mine"], lost["accepted"]) == (False, False)
    assert (lost["end"], lost["silent_s"] * 1000 > TTL_MS) == ("page_silent", True)
