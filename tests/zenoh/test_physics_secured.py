"""`run --sim=physics` where people need certificates, passwords, or a router: its body is seen, and nobody else's."""

from collections.abc import Iterator
from typing import Final

import pytest
import zenoh

from gateway.errors import UnansweredError
from gateway.people.client.live import set_upright
from schemas import keys
from tests.support.heard import bodies
from tests.support.secured import Secured

pytestmark = pytest.mark.full

PHYSICS: Final = ("--sim=physics",)


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with Secured(tmp_path_factory.mktemp("secured"), options=PHYSICS) as made:
        yield made


def test_with_certificates_all_see_it_and_operators_set_it_upright(secured: Secured) -> None:
    with secured.client("anna") as anna, secured.client("otto") as otto:
        seen = bodies(otto)
        lying = seen.wait(lambda _: True)
        assert set_upright(anna).accepted
        seen.wait(lambda body: body.position_m[2] > lying.position_m[2] + 0.005)
        with pytest.raises(UnansweredError):
            set_upright(otto)


def test_with_certificates_nobody_else_publishes_it_or_answers_for_it(secured: Secured) -> None:
    """Zenoh drops both before they reach anybody."""
    asked: list[zenoh.Query] = []
    with secured.client("anna") as anna, secured.client("otto") as otto, secured.session("anna") as stranger:
        seen = bodies(otto)
        forged = seen.wait(lambda _: True).model_copy(update={"position_m": (9.0, 9.0, 9.0)}).model_dump_json()
        stranger.declare_queryable(keys.SIM_UPRIGHT, asked.append)
        for number in range(10):
            stranger.put(keys.SIM_BODY, forged)
            list(stranger.get(keys.STATE))  # the same link: what was put before has passed, or been dropped
            seen.wait(lambda _: True, count=len(seen.all) + number % 2)
        assert set_upright(anna).accepted
        assert all(body.position_m[0] < 9 for body in seen.all)
        assert asked == []
