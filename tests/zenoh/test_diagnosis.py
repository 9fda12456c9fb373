"""Every way in which a laptop does not reach the robot: one line names the step."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import pytest

from gateway import certs
from tests.support.command import Ended, run_here
from tests.support.gateway_process import free_port
from tests.support.secured import HOST, Secured

pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with Secured(tmp_path_factory.mktemp("robot")) as made:
        yield made


def without_a_role(robot: Secured) -> str:
    """The Zenoh file of a laptop that shows the robot's own certificate."""
    text = (robot.folder / "anna.json5").read_text()
    file = robot.folder / "nobody.json5"
    file.write_text(text.replace("anna.pem", "gateway.pem").replace("anna.key", "gateway.key"))
    return str(file)


def said(*arguments: str) -> list[str]:
    """What a Stop that does not come through says."""
    done = run_here("stop", "--timeout", "1", *arguments)
    assert done.returncode == 4, done
    return [line.removeprefix("hexapod-gateway: ") for line in done.stderr.splitlines()]


STEPS: Final[dict[str, tuple[Callable[[Secured], list[str]], str]]] = {
    "a name that nobody knows": (
        lambda _: ["--connect", "tcp/robot.invalid:7447"],
        "no gateway answers on tcp/robot.invalid:7447: name: robot.invalid is unknown … → check the name",
    ),
    "a port where nothing listens": (
        lambda _: ["--connect", f"tcp/{HOST}:{free_port()}"],
        f"TCP: {HOST} rejects port … nothing listens there → does the gateway run",
    ),
    "plain TCP to a port with TLS": (
        lambda robot: ["--connect", f"tcp/{HOST}:{robot.port}"],
        "TLS: the port wants TLS, and you dial it without → dial tls/…, and give --zenoh-config",
    ),
    "no certificate": (
        lambda robot: ["--connect", robot.gateway.endpoint],
        "certificate: the robot wants a certificate, and you have none",
    ),
    "a host that the certificate does not name": (
        lambda robot: ["--connect", f"tls/localhost:{robot.port}", "--zenoh-config", str(robot.folder / "anna.json5")],
        "TLS: the robot's certificate does not name localhost → dial it by a name that it has",
    ),
    "an observer": (
        lambda robot: ["--zenoh-config", str(robot.folder / "otto.json5")],
        "no gateway answered: role: you may not command, as observer → ",
    ),
    "a certificate without a role": (
        lambda robot: ["--zenoh-config", without_a_role(robot)],
        "role: the connection is open, but your certificate is of gateway, which is no role",
    ),
}


@pytest.mark.parametrize("step", STEPS)
def test_one_line_names_the_step_and_what_to_do(robot: Secured, step: str) -> None:
    arguments, says = STEPS[step]
    (line,) = said(*arguments(robot))
    for part in says.split(" … "):
        assert part in line


def test_another_ca(robot: Secured, tmp_path: Path) -> None:
    certs.folder.init(tmp_path / "E", [HOST], port=robot.port)
    certs.folder.issue(tmp_path / "E", "eve", "operator")
    (line,) = said("--zenoh-config", str(tmp_path / "E" / "eve.json5"))
    assert "certificate: the robot's certificate is of another CA than yours" in line
    # Whoever trusts the robot, but shows what it does not know.
    shutil.copy(robot.folder / "ca.pem", tmp_path / "E" / "ca.pem")
    (line,) = said("--zenoh-config", str(tmp_path / "E" / "eve.json5"))
    assert "certificate: the robot does not know the CA of your certificate" in line


# ---- check


def names(done: Ended, verdict: str) -> list[str]:
    return [line[9:24].strip() for line in done.stdout.splitlines() if line.startswith(f"{verdict} ")]


def test_check_goes_the_whole_way(robot: Secured) -> None:
    done = run_here("check", "--zenoh-config", str(robot.folder / "anna.json5"))
    assert done.returncode == 0, done
    assert names(done, "failure") == []
    way = ["certificate", "certificate", "name", "TCP", "TLS", "certificate", "role", "gateway"]
    assert [name for name in names(done, "ok") if name in way] == way
    assert done.stdout.splitlines()[-1].startswith("This machine can reach the gateway")
