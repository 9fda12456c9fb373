"""How long a gateway has published nothing, and what pages are shown of that, in virtual time."""

import doctest

import pytest

from gateway.people.client import silence as silence_module
from gateway.people.client.silence import SILENT_MS, WHY_EVERY_S, Silence
from gateway.people.console.pages.page_messages import LinkMessage
from gateway.people.console.pages.presence import GatewayPresence

MS = 1_000_000


def opened() -> Silence:
    silence = Silence()
    silence.opened(0)
    return silence


def test_after_a_second_without_a_state_it_is_silent_until_the_next() -> None:
    silence = opened()
    assert [silence.is_long(ms * MS) for ms in (0, 1000, 1001)] == [False, False, True]
    silence.received(5000 * MS)
    assert [silence.is_long(ms * MS) for ms in (5000, 6000, 6001)] == [False, False, True]
    assert SILENT_MS == 1000


def test_while_the_first_session_is_being_opened_nobody_is_silent() -> None:
    assert not Silence().is_long(3600_000 * MS)


def test_where_no_session_can_be_opened_it_is_looked_why_at_once() -> None:
    silence = Silence()
    silence.not_opened()
    assert silence.must_diagnose(0)
    silence = opened()
    silence.not_opened()  # the link broke before the session had its subscriptions: its second has begun
    assert not silence.must_diagnose(1000 * MS)


def test_each_look_costs_the_robot_something_and_so_has_three_seconds_before_it() -> None:
    silence = opened()
    looks = []
    for ms in range(0, 10_000, 100):
        if silence.must_diagnose(ms * MS):
            looks.append(ms)
            silence.diagnosed((ms + 500) * MS)  # so long did it take
    assert looks == [1100, 4600, 8100]
    silence.received(10_000 * MS)
    assert not silence.must_diagnose(10_500 * MS), "it is back"
    assert WHY_EVERY_S == 3


# ---- what pages are shown


CONNECTED = LinkMessage(status="connected")


def live() -> GatewayPresence:
    presence = GatewayPresence()
    presence.received_token(True)
    presence.received_state()
    assert presence.link == CONNECTED
    return presence


def test_until_the_first_state_nobody_is_there() -> None:
    presence = GatewayPresence()
    assert presence.link.status == "gone"
    presence.not_opened("nobody listens")
    assert presence.link == LinkMessage(status="gone", detail="nobody listens")
    presence.diagnosed(["its port is closed", "it is off"])
    presence.not_opened("nobody listens")
    assert presence.link == LinkMessage(status="gone", detail="its port is closed\nit is off"), "which says more"
    presence.received_state()
    assert presence.link == CONNECTED


@pytest.mark.parametrize("linked", [True, False])
def test_a_gateway_that_hangs_is_silent_and_a_link_that_is_cut_is_gone(linked: bool) -> None:
    presence = live()
    presence.fell_silent(linked=linked)
    assert presence.link.status == ("silent" if linked else "gone")
    presence.diagnosed(["its journal says why"])
    presence.fell_silent(linked=linked)
    assert presence.link.detail == "its journal says why", "what was found goes on being shown"
    presence.received_state()
    assert presence.link == CONNECTED


def test_a_gateway_that_has_ended_is_gone_at_once_and_no_older_state_brings_it_back() -> None:
    presence = live()
    presence.received_token(False)
    ended = LinkMessage(status="gone", detail="the gateway has ended, or the link to it has")
    assert presence.link == ended
    presence.received_state()  # which was under way
    presence.fell_silent(linked=True)  # to a router
    assert presence.link == ended
    presence.received_token(True)
    presence.received_state()
    assert presence.link == CONNECTED


def test_why_nobody_was_there_is_not_shown_once_somebody_is() -> None:
    presence = live()
    presence.diagnosed(["it is off"])  # the look took a second
    assert presence.link == CONNECTED


def test_the_examples_are_right() -> None:
    assert doctest.testmod(silence_module) == (0, 5)
