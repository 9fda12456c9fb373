"""Hosts on one machine: a robot and its laptops, each a network namespace, with a link of its own between them.

    with Network() as network:
        endpoint = f"tcp/{network.robot_address(0)}:7447"
        gateway = Gateway(folder, {"zenoh": {"listen": [endpoint], "allow_insecure": True}}, prefix=network.robot)
        laptop = Child([*network.laptop(0), *COMMAND, "status", "--follow", "--connect", endpoint], os.environ)
        network.cut(0)
        network.fix(0)

What a program on the robot sends to a laptop that does not read is delayed soon: buffers that way are small.
Nothing of it shows outside: the links exist in the namespaces only. `ip netns exec` becomes the program that it starts,
so a signal to the child is a signal to that program. Monotonic clocks are the same in all of them.
"""

import itertools
import os
import shutil
import subprocess
from contextlib import suppress
from functools import cache
from pathlib import Path

from tests.support.waiting import Closing

MARK = "hexapod-net"
BUFFER_BYTES = 16_384
_numbers = itertools.count()


class Network(Closing):
    """A robot, and two laptops (0 and 1), each linked to the robot and to nobody else."""

    laptops = range(2)

    def __init__(self) -> None:
        """Create them, and remove what could not be finished. Raises RuntimeError with `ip`'s output."""
        _remove_leftovers()
        name = f"{MARK}-{os.getpid()}-{next(_numbers)}"
        self._robot = f"{name}-robot"
        self._laptops = [f"{name}-laptop{number}" for number in self.laptops]
        try:
            for namespace in (self._robot, *self._laptops):
                _run("ip", "netns", "add", namespace)
                _run("ip", "-n", namespace, "link", "set", "lo", "up")
            for number, namespace in enumerate(self._laptops):
                ours = ("link", "add", _link(number), "netns", self._robot)
                _run("ip", *ours, "type", "veth", "peer", "name", "robot", "netns", namespace)
                self._address(number, self.robot_address(number))
                _run("ip", "-n", namespace, "address", "add", f"{_laptop_address(number)}/24", "dev", "robot")
                _run("ip", "-n", namespace, "link", "set", "robot", "up")
                self.fix(number)
                _limit_buffers(namespace, "tcp_rmem")
            _limit_buffers(self._robot, "tcp_wmem")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        for namespace in (self._robot, *self._laptops):
            _remove(namespace)

    @property
    def robot(self) -> tuple[str, ...]:
        """Return what goes before a command to run it on the robot."""
        return ("ip", "netns", "exec", self._robot)

    def laptop(self, number: int) -> tuple[str, ...]:
        """Return what goes before a command to run it on that laptop."""
        return ("ip", "netns", "exec", self._laptops[number])

    def robot_address(self, laptop: int) -> str:
        """Return where that laptop reaches the robot."""
        return f"10.77.{laptop}.1"

    def another_address(self, laptop: int) -> str:
        """Return another address by which that laptop reaches the robot from now on."""
        return self._address(laptop, f"10.77.{laptop}.3")

    def _address(self, laptop: int, address: str) -> str:
        _run("ip", "-n", self._robot, "address", "replace", f"{address}/24", "dev", _link(laptop))
        return address

    def ipv6(self, *, on: bool) -> None:
        _run(*self.robot, "sh", "-c", f"echo {int(not on)} >/proc/sys/net/ipv6/conf/all/disable_ipv6")

    def queued_bytes(self, laptop: int) -> int:
        """Return how many bytes that were sent to this laptop are still with the robot's kernel."""
        asked = (*self.robot, "ss", "-Htn", "state", "established", "dst", _laptop_address(laptop))
        lines = _run(*asked).splitlines()
        return sum(int(line.split()[1]) for line in lines)

    def cut(self, laptop: int) -> None:
        """Cut the link between this laptop and the robot. Neither is informed."""
        _run("ip", "-n", self._robot, "link", "set", _link(laptop), "down")

    def fix(self, laptop: int) -> None:
        _run("ip", "-n", self._robot, "link", "set", _link(laptop), "up")


@cache
def lacks() -> str:
    """Return why there can be no network here, in one line; empty when there can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "Debian package missing: iproute2"
    try:
        Network().close()
    except RuntimeError as error:
        return f"no network namespaces here: {error}"
    return ""


def _link(laptop: int) -> str:
    return f"laptop{laptop}"


def _laptop_address(laptop: int) -> str:
    return f"10.77.{laptop}.2"


def _remove_leftovers() -> None:
    """Remove namespaces whose process was killed before it could remove them."""
    for line in _run("ip", "netns", "list").splitlines():
        name = line.split()[0]
        if name.startswith(f"{MARK}-") and not Path("/proc", name.split("-")[2]).exists():
            _remove(name)


def _remove(namespace: str) -> None:
    with suppress(RuntimeError):
        _run("ip", "netns", "delete", namespace)


def _limit_buffers(namespace: str, setting: str) -> None:
    sizes = f"4096 {BUFFER_BYTES} {BUFFER_BYTES}"
    _run("ip", "netns", "exec", namespace, "sh", "-c", f"echo {sizes} > /proc/sys/net/ipv4/{setting}")


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=20)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout
