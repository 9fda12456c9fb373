"""Commands that a program prints carry the endpoint that they need: each is run here as it was printed."""

import re
import shlex

import pytest

from gateway.own_command import CONNECT_VARIABLE
from tests.support.command import parse, run_here
from tests.support.console_process import Console
from tests.support.fixtures import console_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway

gateway = gateway_fixture(patient())
console = console_fixture()

PRINTS = [
    pytest.param(("estop",), "reset", id="estop"),
    pytest.param(("check", "--move", "--yes"), "reset", id="check --move"),
    pytest.param(("send", "leg", "3", "start", "90"), "send leg 3 start 90 45 120", id="send leg"),
    pytest.param(("send", "servo", "32", "set"), "send servo 32 set 90", id="send servo"),
]
"""What is run, in this order, and the command that it prints."""


@pytest.mark.parametrize("by_variable", [False, True], ids=["--connect", CONNECT_VARIABLE])
@pytest.mark.parametrize(("arguments", "printed"), PRINTS)
def test_a_printed_command_reaches_the_same_gateway(
    gateway: Gateway,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    printed: str,
    by_variable: bool,
) -> None:
    with gateway.client() as client:
        client.estop()
        if arguments[0] == "send":
            client.reset()
            client.start_leg(3, 90, 45, 120)
    if by_variable:
        monkeypatch.setenv(CONNECT_VARIABLE, gateway.endpoint)
    end = run_here(*arguments, *(() if by_variable else ("--connect", gateway.endpoint)))
    monkeypatch.delenv(CONNECT_VARIABLE, raising=False)
    command = f"hexapod-gateway {printed} --connect {gateway.endpoint}"
    assert command in end.stdout + end.stderr
    assert run_here(*shlex.split(command)[1:]).returncode == 0
    assert parse(command)["connect"] == gateway.endpoint


def test_the_page_that_lets_nobody_in_names_its_own_console(console: Console, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in console.env.items():
        monkeypatch.setenv(name, value)
    refused = console.get("/")
    assert refused.status_code == 403
    (command,) = set(re.findall(r"<pre>(.*)</pre>", refused.text))
    assert parse(command)["listen"] == console.url.removeprefix("http://")
    link = re.search(r"at (http://\S+)", run_here(*shlex.split(command)[1:]).stdout)
    assert link is not None
    assert link[1].startswith(console.url)
