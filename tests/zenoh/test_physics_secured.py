"""`run --sim=physics` where people need certificates, passwords, or a router: its body is seen, and nobody else's."""

from collections.abc import Iterator
from typing import Final

import pytest

from gateway.errors import UnansweredError
from gateway.people.client.live import set_upright
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
