"""docs/certificates.md to the letter: five robots and a router, and somebody leaves. Machines are folders."""

import os
import subprocess
import zipfile
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.errors import LeaseError
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, READY, free_port, write_settings
from tests.support.pages import SCP, SSH, SUDO, commands, programs
from tests.support.zenoh_actor import Remote

ROBOTS = [f"robot-{number}" for number in range(1, 6)]
INSTALLER = """#!/bin/sh
[ "$1" = --certs ] && cp -r "$2" ../installed
"""
"""In its place; what it does with such files is shown in tests/box/test_installer.py."""


class Machines:
    """Home is where the CA is; the robots have the repository's folder."""

    def __init__(self, folder: Path) -> None:
        self.home, self.hosts, self.port = folder / "home", folder / "hosts", free_port()
        self.home.mkdir()
        for robot in ROBOTS:
            deploy = self.hosts / robot / "hexapod-gateway" / "deploy"
            deploy.mkdir(parents=True)
            programs(deploy, **{"install.sh": INSTALLER})
        self.router = self.hosts / "router.local"
        self.router.mkdir()
        self._path = programs(folder / "bin", ssh=SSH, scp=SCP, sudo=SUDO)

    def follow(self, *lines: str) -> list[str]:
        """Run these, in which only the router's address is this test's; what they printed."""
        path = f"{self._path}:{Path(COMMAND[0]).parent}:{os.environ['PATH']}"
        env = {**os.environ, "PATH": path, "HOME": str(self.home), "HOSTS": str(self.hosts)}
        script = "\n".join(lines).replace("--host router.local", f"--host 127.0.0.1 --port {self.port}")
        done = subprocess.run(
            ["bash", "-e", "-c", script], cwd=self.home, env=env, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.splitlines()

    def gateway(self, robot: str) -> Child:
        """A robot's gateway, with the files that were brought to it."""
        own = self.hosts / robot / "installed"
        assert own.stat().st_mode & 0o777 == 0o700
        config = write_settings(own / "g.toml", {"zenoh": {"listen": [], "config": str(own / f"{robot}.json5")}})
        return Child([*COMMAND, "run", "--sim", "--config", str(config)], {**os.environ, "STATE_DIRECTORY": str(own)})

    def laptop(self, name: str) -> Path:
        """What somebody makes of the bundle."""
        with zipfile.ZipFile(self.home / f"{name}.zip") as archive:
            archive.extractall(self.home / name)
        return self.home / name


def may_drive(laptop: Path, robot: str) -> bool:
    """Whether it gets the lease."""
    config = laptop / f"{laptop.name}.{robot}.json5"
    with Client(None, zenoh_config=config, source=laptop.name, timeout_s=10, explain=False) as client:
        client.state()
        with client.lease() as lease:
            return lease.verified


def test_five_robots_are_set_up_by_five_commands_and_somebody_leaves(tmp_path: Path) -> None:
    machines, five = Machines(tmp_path), commands("certificates.md", "### Set up")
    five, another = five[:5], five[5:]
    machines.follow(*five)
    machines.follow(*another)
    with ExitStack() as end:
        router = end.enter_context(Remote())
        address = {"listen/endpoints": [f"tls/127.0.0.1:{machines.port}"]}
        router.open(str(machines.router / "router.json5"), address)
        for gateway in [end.enter_context(closing(machines.gateway(robot))) for robot in ROBOTS]:
            gateway.wait_for_output(READY, timeout_s=40)
        anna, bert = machines.laptop("anna"), machines.laptop("bert")
        assert all(may_drive(anna, robot) for robot in ROBOTS)
        assert all(may_drive(bert, robot) for robot in ("robot-1", "robot-4"))
        assert [path.name for path in sorted(bert.glob("*.json5"))] == ["bert.robot-1.json5", "bert.robot-4.json5"]

        revoke, copy, show = commands("certificates.md", "### Somebody leaves")
        said = machines.follow(revoke)
        assert said[0].endswith("list 1 shuts out operator-00.robot-1.robot-4.")
        assert said[1:6] == [f"{robot}: list 1 is in force (brought as anna)." for robot in ROBOTS]
        machines.follow(copy)
        assert "operator-00.robot-1.robot-4" not in (machines.router / "router.json5").read_text()
        listed = [line.split("\t") for line in machines.follow(show)]
        assert {row[0]: row[-1] for row in listed if row[1].startswith("robot.")} == dict.fromkeys(ROBOTS, "1")
        assert all(may_drive(anna, robot) for robot in ROBOTS)
        with pytest.raises(LeaseError, match="revoked"):
            may_drive(bert, "robot-1")
