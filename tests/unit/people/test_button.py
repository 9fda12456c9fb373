"""A program's stop button: when it registers anew, and when a registration does not count. The gateway is a fake."""

from dataclasses import dataclass, field
from typing import cast

import pytest

from gateway.client import RejectedError
from gateway.people.client.lease_requests import LIFE, REGISTRATION_TRIES, Button
from gateway.people.client.lease_requests import Requests as ClientRequests
from schemas.button import ButtonAck
from schemas.telemetry import Ack, Reason

TIMEOUT_MS = 1000.0


@dataclass
class Requests:
    """A gateway that answers after `takes_s`, and its clock."""

    now_s: float = 1000.0
    takes_s: float = 0.01
    denied: Reason | None = None
    asked: list[str] = field(default_factory=list)

    def button_name(self, _name: str | None) -> str:
        return "kitchen"

    def register(self, _name: str | None) -> ButtonAck:
        return self._answer("register", self.denied)

    def check_in(self, token: str, count: int, *, timeout_s: float | None) -> ButtonAck:
        assert timeout_s == TIMEOUT_MS / 1000
        return self._answer(f"alive {token} {count}")

    def _answer(self, what: str, reason: Reason | None = None) -> ButtonAck:
        self.asked.append(what)
        self.now_s += self.takes_s
        token = f"token {self.asked.count('register')}"
        return ButtonAck(accepted=reason is None, reason=reason, button=token, timeout_ms=TIMEOUT_MS)


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> Requests:
    made = Requests()
    monkeypatch.setattr("gateway.people.client.lease_requests.time.monotonic", lambda: made.now_s)
    return made


def button(requests: Requests) -> Button:
    return Button(cast(ClientRequests, requests), lambda _: Ack(accepted=True), None)


def test_a_button_registers_anew_before_its_clock_may_have_fallen_behind_and_goes_on_if_that_is_denied(
    requests: Requests,
) -> None:
    kitchen = button(requests)
    kitchen.register()
    requests.now_s += LIFE * TIMEOUT_MS / 1000 - 1
    kitchen.alive()
    requests.now_s += 1
    kitchen.alive()
    assert requests.asked == ["register", "alive token 1 1", "register", "alive token 2 1"]
    requests.now_s += LIFE * TIMEOUT_MS / 1000
    requests.denied = Reason.BUTTON_DENIED
    kitchen.alive()
    kitchen.alive()
    assert requests.asked[4:] == ["register", "alive token 2 2", "alive token 2 3"]
    requests.now_s += LIFE * TIMEOUT_MS / 10_000
    kitchen.alive()
    assert requests.asked[-2:] == ["register", "alive token 2 4"], "it tries again"


def test_a_registration_that_was_held_back_does_not_count(requests: Requests) -> None:
    """Each later check-in is compared with it: all of them would count for longer by that delay."""
    kitchen = button(requests)
    requests.takes_s = 0.51
    with pytest.raises(RejectedError, match="stale") as error:
        kitchen.register()
    assert error.value.reason == Reason.STALE
    assert requests.asked == ["register"] * REGISTRATION_TRIES
    requests.takes_s = 0.5
    kitchen.alive()
    assert requests.asked[REGISTRATION_TRIES:] == ["register", f"alive token {REGISTRATION_TRIES + 1} 1"]
