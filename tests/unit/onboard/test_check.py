"""`check`: what is planted on a machine, and the line that it prints."""

import ast
import datetime as dt
import errno
import json
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import pytest

from gateway import certs
from gateway.errors import ConfigError, GatewayError, SpiError
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.protocols import SpiProtocol
from gateway.onboard import whole
from gateway.onboard.check import installation, security, wire
from gateway.onboard.check.installation import AS_ROOT
from gateway.onboard.check.move import output
from gateway.onboard.check.table import CheckedRobot, Probes, Result, Verdict, results
from gateway.onboard.holders import Holder, OpenFiles
from gateway.onboard.whole import Whole
from gateway.robot.runtime import calibrations
from gateway.robot.settings import Settings
from gateway.wire import Capabilities
from schemas.keys import CALIBRATION
from schemas.telemetry import ServoTelemetry, Telemetry
from tests.support.certs_folder import DAY, NOW, make_folder
from tests.support.gateway_process import dialling
from tests.support.machine_tree import PI_4, MachineTree
from tests.support.pages import parse_commands, texts

__all__ = ["make_folder"]  # a fixture
GATEWAY = Path(certs.__file__).parents[1]
LENGTH: dict[str, Any] = {"framing": "length-prefixed"}
PROBES: tuple[Probes, ...] = (
    *(wire.uart, wire.power, wire.plugin, wire.spi_bus, wire.framing, wire.calibration),
    *(*security.PROBES, installation.machine, installation.restarts, installation.state, installation.users),
    installation.unit,
)
"""UART and board first: what looks for the gateway, on SPI, comes behind them."""


def robot(root: Path, **sections: Any) -> CheckedRobot:
    return CheckedRobot(Settings.of(sections), root, lambda *_: {})


NEEDRESTART = "etc/needrestart/conf.d/hexapod-gateway.conf"
KEEPS = (GATEWAY / "deploy/debian/needrestart.conf").read_text().splitlines()[-1]
APT, REBOOT = "etc/apt/apt.conf.d/50unattended-upgrades", "Unattended-Upgrade::Automatic-Reboot"
UP = {"LoadState": "loaded", "ActiveState": "active", "UnitFileState": "enabled", "NeedDaemonReload": "no"}
UP |= {"ExecStopPost": "{ path=/run/program ; argv[]=/run/program stop-servos }"}
DROP_IN = "/etc/systemd/system/hexapod-gateway.service.d/own.conf"
STATE = "var/lib/hexapod-gateway"
LIBRARY = "usr/lib/hexapod-gateway"
OTHER_UNIT = "etc/systemd/system/hexapod-gateway.service"
UNIT_FILE = "usr/lib/systemd/system/hexapod-gateway.service"


class Installed(CheckedRobot):
    """A package in a folder, with what systemd would show of its unit. Its user is the one that runs this."""

    def __init__(self, root: Path) -> None:
        super().__init__(root=root)
        self.write("run/program", "#!/run/program", 0o755)
        for place in (f"{LIBRARY}/1.1.0/units/hexapod-gateway.service", UNIT_FILE):
            self.write(place, "[Service]", 0o644)
        (root / LIBRARY / "current").symlink_to("1.1.0")
        for folder in (STATE, "run/systemd/system"):
            (root / folder).mkdir(parents=True)
        self.service = os.getuid(), os.getgid()
        self.version, self.files, self.status = "1.1.0", Whole(), "install installed"
        self.unit: dict[str, str] = dict(UP)

    def drop_in(self, text: str) -> None:
        self.write(DROP_IN[1:], f"[Service]\n{text}\n")
        self.show(DropInPaths=DROP_IN)

    def leave(self, status: str, why: str = "") -> str:
        """Let dpkg show this of the package. Return `why`."""
        self.status = status
        return why

    def show(self, **properties: str) -> None:
        self.unit.update(properties)

    def write(self, name: str, text: str = "", mode: int = 0o600) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        path.chmod(mode)

    def keys(self, name: str) -> None:
        certs.folder.init(self.root / "C", ["127.0.0.1"])
        for source, target in (("ca.key", name), ("ca.pem", "ca.pem")):
            self.write(f"etc/hexapod-gateway/zenoh/{target}", (self.root / "C" / source).read_text(), 0o640)

    def file_for_folder(self) -> None:
        (self.root / STATE).rmdir()
        self.write(STATE)

    def mask(self) -> None:
        (self.root / "run/systemd/system/hexapod-gateway.service").symlink_to("/dev/null")
        self.show(LoadState="masked")

    def runs(self, variables: str, maps: str = "") -> None:
        self.write("proc/7/environ", variables)
        self.write("proc/7/maps", maps)
        self.show(MainPID="7")

    def forget_python(self) -> None:
        self.write("x", "#!/usr/bin/python3.1 -I\n", 0o755)
        self.show(ExecStart="{ path=/x ; argv[]=/x }")


Plant = Callable[[Installed], object]
PLANTED: tuple[tuple[Plant, str], ...] = (
    (lambda robot: setattr(robot, "files", Whole(changed=("/usr/a", "/usr/b"))), "not as installed: /usr/a, /usr/b"),
    (lambda robot: setattr(robot, "files", Whole(added=("/usr/a",))), "and not installed with it: /usr/a"),
    (lambda robot: setattr(robot, "files", Whole(closed=("/usr/a",))), "not readable by all"),
    (lambda robot: setattr(robot, "version", "1.2.0"), "1.2.0 is installed, but 1.1.0 runs: the upgrade waits"),
    (
        lambda robot: robot.write(f"{LIBRARY}/failed", robot.leave("install half-configured", "no x")),
        "no x. So 1.1.0 goes on",
    ),
    (lambda robot: robot.leave("install unpacked"), "1.1.0 is unpacked. So 1.1.0 goes on"),
    (lambda robot: robot.leave("install half-installed"), "1.1.0 is only partly installed"),
    (lambda robot: robot.leave("deinstall half-configured"), "1.1.0 is only partly installed"),
    (
        lambda robot: robot.runs("", "7f-8a r-xp /usr/lib/hexapod-gateway/1.0.9.kept/x.so"),
        "the running service is 1.0",
    ),
    (lambda robot: robot.path(UNIT_FILE).unlink(), f"/{UNIT_FILE} is not this release's"),
    (lambda robot: robot.write(OTHER_UNIT, "[Service]"), f"/{OTHER_UNIT} is not this release's"),
    (lambda robot: robot.show(ExecStart="{ path=/none ; argv[]=/none }"), "/none cannot be run"),
    (lambda robot: robot.forget_python(), "/usr/bin/python3.1 cannot be run"),
    (lambda robot: robot.show(ExecStopPost="{ path=/run/program ; }"), "runs no stop-servos after its end"),
    (lambda robot: robot.mask(), "/run/systemd/system/hexapod-gateway.service is not"),
    (lambda robot: robot.show(NeedDaemonReload="yes"), "hexapod-gateway was edited, but systemd still"),
    (lambda robot: robot.write(DROP_IN[1:], mode=0o644), "hexapod-gateway was edited, but systemd still"),
    (lambda robot: robot.drop_in("Environment=GATEWAY_OPTIONS=--sim\nExecStopPost="), "makes the controller a simu"),
    (lambda robot: robot.drop_in("ExecStopPost="), "what Stops depend on: ExecStopPost"),
    (lambda robot: robot.drop_in("Environment=HEXAPOD_SPI__FRAMING=plain"), "depend on: HEXAPOD_SPI__FRAMING"),
    (lambda robot: robot.drop_in("User=root\nNice=3"), "Stops depend on: Nice, User"),
    (lambda robot: robot.drop_in("Environment=A=1 PYTHONPATH=/x\nMemoryMax=64M"), "depend on: MemoryMax, PYTHONPATH"),
    (lambda robot: robot.drop_in("ExecStopPost=\nExecStopPost=/opt/x \\\n  stop-servos"), "depend on: ExecStopPost"),
    (lambda robot: robot.runs("A=1\0HEXAPOD_SPI__FRAMING=plain\0"), "HEXAPOD_SPI__FRAMING is in the service's env"),
    (lambda robot: robot.runs("PYTHONPATH=/x\0"), "PYTHONPATH is in the service's environment"),
    (lambda robot: robot.file_for_folder(), "is no folder"),
    (lambda robot: robot.path(STATE).chmod(0o500), f"may not read and write /{STATE}"),
    (lambda robot: robot.write(f"{STATE}/a", mode=0o400), f"may not read and write /{STATE}/a"),
    (lambda robot: robot.write("etc/hexapod-gateway/a.key", mode=0o604), "not only root and the service may read"),
    (lambda robot: robot.keys("old.key"), "zenoh/old.key is the authority's key"),
    (lambda robot: robot.keys("ca.key"), "zenoh/ca.key is the authority's key"),
    (lambda _: None, ""),
    (lambda robot: robot.runs("GATEWAY_HANDOVER_ESTOP=1\0"), ""),
    (lambda robot: robot.drop_in("# ExecStopPost=\n;User=root\nCPUWeight=9"), ""),
    (lambda robot: robot.drop_in("Environment=LANG=C"), ""),
)
"""Each fault with its sentence, and last what is well."""


class Scene:
    """`plant` returns what the probes look at; `patch` takes the place of what a test cannot plant.

    `lines` are all with this name.
    """

    def __init__(
        self,
        name: str,
        plant: Callable[[Path], CheckedRobot],
        *lines: str,
        patch: Mapping[str, object] = MappingProxyType({}),
        probes: tuple[Probes, ...] = PROBES,
    ) -> None:
        self.name, self.plant, self.lines, self.patch, self.probes = name, plant, lines, patch, probes


def here(
    tree: Mapping[str, Any] | None = None,
    files: Mapping[str, str] = MappingProxyType({}),
    act: Callable[[Path], object] = lambda _: None,
    **sections: Any,
) -> Callable[[Path], CheckedRobot]:
    """Return settings, in which ROOT is the folder, and a machine with this tree and these files, after `act`."""

    def plant(root: Path) -> CheckedRobot:
        if tree is not None:
            MachineTree(root, **tree)
        for name, text in files.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)
        act(root)
        return robot(root, **json.loads(json.dumps(sections).replace("ROOT", str(root))))

    return plant


def neighbours(root: Path) -> None:
    tree = MachineTree(root)
    tree.add("spi0.1", "fb_st7789v")
    tree.add("spi0.2", "mcp251x")
    tree.add("spi0.3", None)


def clocked(speed_hz: int, *lines: str, **spi: Any) -> Scene:
    return Scene("SPI speed", here(spi={"speed_hz": speed_hz, **spi}), *lines)


def named(host: str = "127.0.0.1", days: int = certs.LEAF_DAYS) -> Callable[[Path], CheckedRobot]:
    """Return a robot whose certificate is for this host."""
    return here(
        act=lambda root: certs.folder.init(root / "D", [host], days=days), zenoh={"config": "ROOT/D/gateway.json5"}
    )


def dated(days_left: int, *lines: str) -> Scene:
    """Return the robot's certificate, which is good for 90 days."""

    def read(look: CheckedRobot) -> Iterator[Result | None]:
        return iter(list(security.certificates(look, NOW + (90 - days_left) * DAY))[1:2])

    return Scene("certificates", named(days=90), *lines, probes=(read,))


def unit(**properties: str) -> Callable[[Path], CheckedRobot]:
    """Return what systemd shows of an installed unit."""
    return but(Installed, unit={**UP, **properties})


def brought(*names: str, damaged: bool = False, of: str = "other") -> Callable[[Path], CheckedRobot]:
    """Return a robot's certificates, in which these files are of another authority, or of a laptop (`of`).

    `damaged`: the list in the state directory is.
    """

    def act(root: Path) -> None:
        for each in ("own", "other"):
            certs.folder.init(root / each, ["127.0.0.1"])
            certs.folder.issue(root / each, "anna", "operator")
            certs.folder.issue(root / each, "carl", "operator")
            certs.folder.revoke(root / each, "carl")
        (root / "state").mkdir()
        if damaged:
            (root / "state/revoked.crl").write_text("x")
        for name in names:
            source = root / "other" / name if of == "other" else root / "own" / name.replace("gateway", of)
            (root / "own" / name).write_bytes(source.read_bytes())

    return here(act=act, zenoh={"config": "ROOT/own/gateway.json5"}, state={"path": "ROOT/state"})


def raises(error: Exception, cause: Exception | None = None) -> Callable[..., None]:
    def call(*_: object, **__: object) -> None:
        raise error from cause

    return call


class Opened:
    """A UART, a board's plug-in, or an interface to the power board."""

    def open(self) -> None: ...

    def close(self) -> None: ...

    def shutdown(self) -> None: ...


def listens(*endpoints: str) -> Callable[[Path], CheckedRobot]:
    return here(zenoh={"listen": list(endpoints), "allow_insecure": True})


def uart(path: str) -> Callable[[Path], CheckedRobot]:
    return here({"model": PI_5}, wire={"name": "elkapod-2025"}, controller={"uart": path})


def console(names: str) -> Callable[[Path], CheckedRobot]:
    active = {"sys/class/tty/console/active": f"{names}\n"}
    return here(files=active, wire={"name": "elkapod-2025"}, controller={"uart": "/dev/null"})


def not_tried(*_: object) -> None:
    pytest.fail("it was opened")


def built(version: str) -> Callable[[Path], CheckedRobot]:
    """Return a kernel of a Raspberry Pi 5."""
    node = "axi/pcie@120000/rp1/spi@50000"
    return here({"driver": "dw_spi_mmio", "model": PI_5, "node": node, "version": f"{PI_4}{version}\n"})


def kept(calibration: RobotCalibration | str) -> Callable[[Path], CheckedRobot]:
    def act(root: Path) -> None:
        path = root / "calibration.toml"
        path.write_text(calibration) if isinstance(calibration, str) else calibrations.write(path, calibration)

    return here(act=act, state={"path": "ROOT"})


def access(change: Callable[[str], str]) -> Callable[[Path], CheckedRobot]:
    """Return an access control that differs from what this release makes."""

    def act(root: Path) -> None:
        certs.folder.init(root, ["127.0.0.1"], port=7448)
        file = root / "gateway.json5"
        file.write_text(change(file.read_text()))

    return here(act=act, zenoh={"config": "ROOT/gateway.json5", "allow_insecure": True})


CAN, ETHERNET = 280, 1


def interface(kind: int | None, flags: int = 0) -> Callable[[Path], CheckedRobot]:
    """Return a network interface in the kernel's files."""
    found = {"sys/class/net/can7/type": f"{kind}\n", "sys/class/net/can7/flags": f"{flags:#x}\n"}
    return here(files={} if kind is None else found, power={"interface": "socketcan", "channel": "can7"})


PI_5 = "Raspberry Pi 5 Model B Rev 1.0"
RENEW = (
    "where ca.key is: hexapod-gateway certs renew gateway --dir DIR, and copy gateway.pem here, then: sudo systemctl"
)
TAKES = "an emergency stop takes {} ms to write"
HWMON = "sys/class/hwmon/hwmon1"
CPU = "sys/devices/system/cpu/cpu0/cpufreq/scaling_"
GOOD = ("ca.pem is good until", "gateway.pem is good until")
DENIED = {"os.access": lambda *_: False}
NODE: dict[str, Any] = {"spi": {"device": "/dev/null"}}
EMPTY = SimpleNamespace(f_bavail=1 << 20, f_frsize=1024, f_flag=0, f_files=9, f_favail=999)
SPIDEV, SERIAL = "gateway.onboard.check.wire.KernelDevice", "gateway.onboard.check.wire.SerialUart"
BUSY = raises(SpiError("is held"), BlockingIOError(errno.EAGAIN, "busy"))
SLCAN = here(power={"interface": "slcan", "channel": "/dev/null"})
BUS = "gateway.onboard.check.wire.open_bus"
MOUNT = "gateway.onboard.check.installation.mount_of"
UNIT = "systemd unit"
NULL = uart("/dev/null")


X, Y = Holder(7, "x", "x.service"), Holder(8, "y", "")


def held_by(*holders: Holder) -> dict[str, object]:
    return {"gateway.onboard.holders.OpenFiles.holders": lambda *_: list(holders)}


def but(plant: Callable[[Path], CheckedRobot], **differs: Any) -> Callable[[Path], CheckedRobot]:
    def plants(root: Path) -> CheckedRobot:
        made = plant(root)
        vars(made).update(differs)
        return made

    return plants


def served(plant: Callable[[Path], CheckedRobot]) -> Callable[[Path], CheckedRobot]:
    """Return a machine with the service's user."""
    return but(plant, service=(9, 9))


A_BOARD = SimpleNamespace(
    name="x", built_in=None, capabilities=Capabilities(), plugin=Opened(), has_uart=False, framed=False
)
BOARD = but(here(), settings=SimpleNamespace(**{**vars(Settings()), "wire": A_BOARD}))
"""A wire that is not built in."""


def disk(**differs: int) -> dict[str, object]:
    return {"os.statvfs": lambda _: SimpleNamespace(**{**vars(EMPTY), **differs}), MOUNT: lambda _: ("/mnt", "ext4")}


# fmt: off
SCENES = (
    Scene(UNIT, unit(), "ok systemd unit: is enabled and active"),
    Scene(UNIT, here(), "warning … systemd does not run here"),
    Scene(UNIT, unit(ActiveState="inactive"), "warning … → sudo systemctl enable --now hexapod-gateway"),
    Scene(UNIT, unit(UnitFileState="disabled"), "warning … → sudo systemctl enable --now hexapod-gateway"),
    Scene(UNIT, unit(ActiveState="failed", Result="exit-code"),
          "failure … has failed (exit-code) → journalctl -u … sudo systemctl reset-failed"),
    Scene(UNIT, unit(LoadState="not-found"), "warning … is not installed … with it: sudo apt install"),
    Scene(UNIT, unit(LoadState="bad-setting"), "failure … cannot be loaded (bad-setting)"),
    Scene("user", here(), "failure user: there is no user hexapod-gateway, so … sudo systemd-sysusers"),
    Scene("user", served(here()), *("failure user: there is no group",) * 3, patch={"grp.getgrall": list}),
    Scene("state", unit(), "warning … is on overlay, which a boot empties", probes=(installation.state_disk,),
          patch={MOUNT: lambda _: ("/", "overlay")}),
    Scene("state", here(files={"etc/fstab": "# /dev/a /\n/dev/b / ext4\n\n/dev/c /var/lib/hexapod-gateway ext4 x"}),
          "failure state: /dev/c is not mounted on /var/lib/hexapod-gateway: … sudo mount /var/lib/hexapod-gateway "
          "&& sudo systemctl reset", probes=(installation.state_disk,), patch={MOUNT: lambda _: ("/", "ext4")}),
    Scene("state", here(files={"etc/fstab": "/dev/c /srv/x ext4"}, state={"path": "/srv/x/y"}), probes=(
          installation.state_disk,), patch={MOUNT: lambda _: ("/srv/x", "ext4")}),
    *(Scene("disk", here(), *lines, patch=disk(**differs)) for differs, lines in (
          ({}, ()),
          ({"f_flag": os.ST_RDONLY}, ["/mnt is mounted read-only … sudo mount -o remount,rw /mnt"]),
          ({"f_bavail": 3 << 10}, ["failure disk: /mnt has 3 MB free … sudo journalctl --vacuum-size=50M"]),
          ({"f_favail": 9}, ["failure disk: /mnt has … and room for 9 files … sudo du -xh /mnt"]))),
    *(Scene("disk", here(), *lines, patch={**disk(f_bavail=free_kb), MOUNT: lambda _: ("/run", "tmpfs")})
      for free_kb, lines in ((1 << 10, ()), (900, ["failure disk: /run has 0 MB free … the service cannot start → "]))),
    Scene("Wi-Fi", here(files={"sys/class/net/wlan0/phy80211/x": ""}), "warning Wi-Fi: wlan0 saves power … sudo tee",
          patch={"fcntl.ioctl": lambda *_: None}),
    Scene("processor", here(files={f"{CPU}governor": "powersave", f"{CPU}driver": "cpufreq-dt"}),
          "warning processor: its governor is powersave … sudo tee /etc/tmpfiles.d/"),
    Scene("processor", here(files={f"{CPU}governor": "powersave", f"{CPU}driver": "intel_pstate"})),
    Scene("processor", here(files={f"{CPU}governor": "ondemand", f"{CPU}driver": "cpufreq-dt"})),
    Scene("supply", here(files={f"{HWMON}/name": "rpi_volt\n", f"{HWMON}/in0_lcrit_alarm": "1\n"}),
          "warning supply: this Raspberry Pi's supply voltage is low"),
    Scene("supply", here(files={f"{HWMON}/name": "rpi_volt", f"{HWMON}/in0_lcrit_alarm": "0"})),
    Scene("needrestart", here(files={"usr/sbin/needrestart": ""}), "warning needrestart: … restarts the service after"),
    Scene("needrestart", here(files={"usr/sbin/needrestart": "", NEEDRESTART: f"# {KEEPS}"}), "does not forbid it"),
    Scene("needrestart", here(files={"usr/sbin/needrestart": "", NEEDRESTART: KEEPS})),
    Scene("needrestart", here()),
    Scene("reboots", here(files={APT: f'// {REBOOT} "false";\n{REBOOT} "true";\n'}),
          "warning reboots: … reboots this machine … sudo tee /etc/apt/apt.conf.d/99"),
    Scene("reboots", here(files={APT: f'{REBOOT} "true";', f"{APT}-own": f'{REBOOT} "0";'})),
    Scene("reboots", here(files={APT: f'//{REBOOT} "true";\n{REBOOT}-Time "02:00";'})),
    Scene("SPI device", here(spi={"device": "/bin/sh"}), "failure … /bin/sh is no device node → … switch SPI on"),
    Scene("SPI device", here(spi={"device": "/dev/none"}), "/dev/none: No such file … → without … switch SPI"),
    Scene("SPI device", served(here(**NODE)), "may not be opened … → sudo chgrp spi /dev/null && sudo chmod",
          patch=DENIED),
    Scene("SPI device", here(**NODE), "→ until the next boot: sudo chown", patch=DENIED),
    Scene("SPI device", here(**NODE), "failure SPI device: /dev/null cannot be opened … is /dev/null a SPI device?"),
    Scene("SPI device", here(**NODE), "failure SPI device: /dev/null cannot be opened",
          patch={"gateway.robot.spi.outside.is_gateways": raises(OSError(errno.ENODEV, "no such device"))}),
    Scene("SPI device", here(**NODE), "failure … /dev/null is held by another program … sudo hexapod-gateway check",
          patch={**held_by(), SPIDEV: BUSY, "gateway.robot.spi.outside.is_gateways": lambda _: False}),
    Scene("SPI device", here(**NODE), "failure … /dev/null is held by x (process 7, x.service), y (process 8) … sudo "
          "systemctl stop x.service; sudo kill 8; sudo systemctl reset-failed hexapod-gateway; sudo systemctl restart",
          patch={**held_by(X, Y), SPIDEV: BUSY, "gateway.robot.spi.outside.is_gateways": lambda _: False}),
    Scene("SPI device", here(**NODE), "ok SPI device: /dev/null is the running gateway's",
          patch={**held_by(X), SPIDEV: BUSY, "gateway.robot.spi.outside.is_gateways": lambda _: True}),
    Scene("SPI device", but(here(**NODE), unit={**UP, "MainPID": "7"}), "failure … /dev/null is held by y (process 8)",
          patch={**held_by(X, Y), SPIDEV: BUSY, "gateway.robot.spi.outside.is_gateways": lambda _: True}),
    Scene("SPI device", but(here(**NODE), unit={**UP, "MainPID": "7"}), "ok … is the running gateway's",
          patch={**held_by(X), SPIDEV: BUSY, "gateway.robot.spi.outside.is_gateways": lambda _: True}),
    *(Scene("port", but(listens("tcp/127.0.0.1:7447"), unit={**UP, "MainPID": "7"}), line, patch={
          "gateway.onboard.check.security.bind_fault": lambda _: OSError(errno.EADDRINUSE, "in use"),
          "gateway.onboard.holders.OpenFiles.listeners": lambda *_, those=those: those,
          "gateway.host.effective.running": lambda: None}) for those, line in (
              ([X], "ok port: tcp/127.0.0.1:7447 is in use by the running gateway"),
              ([X, Y], "failure port: tcp/127.0.0.1:7447 is held by y (process 8), … set another zenoh.listen, or, if "
               "that may end, with all legs stopped: sudo kill 8; sudo systemctl reset-failed"),
              ([], "failure port: tcp/127.0.0.1:7447 is held by another program … sudo hexapod-gateway check"))),
    Scene("wire", here()),
    Scene("wire", BOARD, "ok wire: x opens →"),
    Scene("wire", BOARD, "failure wire: x: no such device → read what the plug-in needs",
          patch={"gateway.onboard.check.wire.PluginDevice": raises(SpiError("x: no such device"))}),
    Scene("SPI controller", here({}), "ok SPI controller: Raspberry Pi 4 Model B Rev 1.4, Linux 6.6.31+rpt-rpi-v8, "
          "spi-bcm2835, chip select is a GPIO →"),
    Scene("SPI controller", here({"cs_gpios": None}), "the controller drives chip select"),
    Scene("SPI controller", here(), "ok … nothing is known of it →"),
    Scene("SPI controller", built("#1 SMP Debian 1:6.6.74-1 (2025-02-04)"), "warning … a kernel of 2025-02-04"),
    Scene("SPI controller", built("#1 SMP Debian 1:6.6.74-1 (2025-02-05)"), "ok … Raspberry Pi 5"),
    Scene("SPI controller", built("#1 SMP PREEMPT Wed Mar 19 11:03:01 GMT 2025"), "ok … dw_spi_mmio"),
    Scene("SPI controller", built("#1 SMP PREEMPT"), "warning … a kernel of an unknown time … update the kernel"),
    Scene("SPI controller", here({"driver": "dw_spi_mmio", "model": "StarFive VisionFive 2"}),
          "ok SPI controller: StarFive"),
    Scene("SPI bus", here({}), "ok SPI bus: no other driver uses it"),
    Scene("SPI bus", here(act=neighbours), "warning … spi0.1 (driver fb_st7789v), spi0.2 (driver mcp251x): an"),
    clocked(2_500_000, f"ok … {TAKES.format('0.6')}"),
    clocked(2_500_001, "warning … set spi.speed_hz = 2500000, or measure"),
    clocked(50_000, "ok"),
    clocked(10_000, "warning … up to 2.5 MHz → set spi.speed_hz = 2500000"),
    clocked(2_500_000, TAKES.format("12.4"), **LENGTH, frame_gap_us=1000),
    Scene("SPI speed", here(wire={"name": "elkapod-2025"}), "ok SPI speed: 1 MHz; a frame takes 0.6 ms to write"),
    Scene("SPI lists", here({}), "ok SPI lists: the controller reads each"),
    Scene("SPI lists", here({"cs_gpios": None}), "warning … whether spi-bcm2835 releases … hexapod-gateway check "
          "--move"),
    Scene("SPI lists", here({"cs_gpios": None}, spi=LENGTH), "ok SPI lists: the controller reads each"),
    Scene("SPI lists", here(), "warning SPI lists: it is unknown whether this driver"),
    Scene("framing", here(), "warning framing: plain, … with it the published STM32 firmware hangs"),
    Scene("framing", here(spi=LENGTH), "ok framing: length-prefixed, as "),
    Scene("framing", here(wire={"name": "elkapod-2025"})),
    Scene("SPI lists", here(wire={"name": "elkapod-2025"})),
    Scene("UART", here()),
    Scene("UART", uart("/none/ttyAMA1"), ": No such file … → set controller.uart … switch it on and reboot: sudo"),
    Scene("UART", uart("/bin/sh"), "failure UART: /bin/sh is no device node"),
    Scene("UART", NULL, "failure UART: the UART /dev/null cannot be opened"),
    Scene("UART", served(NULL), "→ sudo chgrp dialout /dev/null", patch=DENIED),
    Scene("UART", console("tty1 null"), "failure UART: /dev/null has Linux's console", patch={SERIAL: not_tried}),
    Scene("UART", but(NULL, shown=lambda _: {"ActiveState": "active"}), "failure UART: /dev/null has … a login",
          patch={SERIAL: not_tried}),
    Scene("UART", but(NULL, gateway_runs=True), "ok UART: … is the running gateway's", patch={SERIAL: not_tried}),
    Scene("UART", console("tty1"), "ok UART: /dev/null opens", patch={SERIAL: lambda _: Opened()}),
    Scene("UART", NULL, "failure UART: /dev/null is held by x (process 7, x.service)",
          patch={**held_by(X), SERIAL: BUSY}),
    Scene("UART", served(uart("/dev/full")), "warning UART: /dev/full opens, but the unit lets the service open "
          "ttyAMA… only → … sudo tee /etc/systemd/system/hexapod-gateway.service.d/uart.conf <<<$'[Service]\\n"
          "DeviceAllow=char-full rw' && sudo systemctl daemon-reload",
          patch={SERIAL: lambda _: Opened()}),
    *(Scene("serial", but(here(files={"run/udev/data/c1:3": data}, **where),
                          shown=lambda unit, on=on: {"ActiveState": "active" if unit[:-8] in on else ""}), *lines)
      for where in (dict[str, Any](power={"interface": "slcan", "channel": "/dev/null"}),
                    dict[str, Any](wire={"name": "elkapod-2025"}, controller={"uart": "/dev/null"}))
      for data, on, lines in (
          ("", "ModemManager brltty", ["warning serial: ModemManager brltty may read from /dev/null … sudo systemctl "
                                       "disable --now ModemManager brltty"]),
          ("I:1\nE:ID_MM_DEVICE_IGNORE=1\n", "ModemManager brltty", ["serial: brltty may read … --now brltty"]),
          ("E:ID_MM_DEVICE_IGNORE=1\n", "ModemManager", []), ("", "", []))),
    Scene("calibration", here(), "ok calibration: is kept in memory only"),
    Scene("calibration", kept(RobotCalibration()), "ok calibration: revision 0, servos that differ: 0 ("),
    Scene("calibration", kept(RobotCalibration(3, {11: ServoMapping(5_00)})), "revision 3, servos that differ: 1 ("),
    Scene("calibration", kept("trim = 7\n"), "failure … version is None; this gateway reads 1; nothing can be started "
          "→ … hexapod-gateway calibrate"),
    Scene("calibration", kept("trim = 7\n"), "warning … you may not read /", patch=DENIED),
    Scene("power board", here()),
    Scene("power board", here(power={"interface": "slcan", "channel": "/none"}), "/none: No such file … → plug"),
    Scene("power board", served(SLCAN), "→ sudo chgrp dialout /dev/null", patch=DENIED),
    Scene("power board", interface(None), "failure power board: can7 is no CAN interface"),
    Scene("power board", interface(ETHERNET, 1), "failure power board: can7 is no CAN interface"),
    Scene("power board", interface(CAN, 0x40080), "can7 is switched off → … sudo tee /etc/systemd/network/80-can7"),
    Scene("power board", interface(CAN, 0x40081), "failure power board: … cannot be opened"),
    Scene("power board", here(power={"interface": "sim"}), "failure power board: is simulated"),
    Scene("power board", SLCAN, "failure power board: e → see dmesg", patch={BUS: raises(GatewayError("e"))}),
    Scene("power board", SLCAN, "ok power board: /dev/null opens … whether the board answers",
          patch={BUS: lambda _: Opened()}),
    Scene("power board", but(SLCAN, gateway_runs=True), "ok power board: … is the running", patch={BUS: not_tried}),
    dated(61, "ok certificates: … gateway.pem is good until"),
    dated(59, f"warning … gateway.pem expires on … in 59 days → {RENEW}"),
    dated(1, f"warning … in 1 day → {RENEW}"),
    dated(-1, f"failure … gateway.pem expired on … {RENEW}"),
    dated(490, "failure … gateway.pem is valid only from … set the clock (timedatectl)"),
    Scene("certificates", here()),
    Scene("certificates", brought(), *GOOD),
    Scene("certificates", brought("gateway.pem"), *GOOD,
          "failure certificates: … own, gateway.pem is of another authority than … "
          "sudo hexapod-gateway setup --certs FOLDER"),
    Scene("certificates", brought("gateway.key"), *GOOD, "failure … gateway.key is not the key of … gateway.pem: no"),
    Scene("certificates", brought("gateway.pem", "gateway.key", of="anna"), *GOOD,
          "gateway.pem is of operator, not of a robot"),
    Scene("revoked", here()),
    Scene("revoked", brought(), "ok revoked: list 1 of … shuts out 1"),
    Scene("revoked", brought("revoked.crl", damaged=True), "failure … /state/revoked.crl: this is no list of … FILE /",
          "warning revoked: … own/revoked.crl is of another authority, so it shuts nobody out → copy revoked.crl"),
    Scene("Zenoh", here(), "ok Zenoh: its configuration is these settings alone"),
    Scene("Zenoh", here(zenoh={"config": "/none.json5"}), "failure Zenoh: … /none.json5 … → fix it there"),
    Scene("Zenoh", here(zenoh={"listen": ["tcp/0.0.0.0:7447"]}), "failure Zenoh … → fix it there"),
    Scene("Zenoh", here(), "failure Zenoh: x: Permission denied → let the service … setup",
          patch={"gateway.onboard.check.security.service_config": raises(ConfigError("x: Permission denied"))}),
    Scene("Zenoh", listens("tcp/0.0.0.0:7447"), "warning Zenoh: … anyone who reaches tcp/0.0.0.0:7447 can move"),
    Scene("port", lambda root: robot(root, zenoh={"listen": [], "config": dialling(root, "tcp/127.0.0.1:1")}),
          "ok port: none: the gateway does not listen"),
    Scene("port", listens("tcp/192.0.2.1:7447", "tcp/h:99999"),
          "warning port: tcp/192.0.2.1:7447 is not there yet (Cannot assign requested address): the service keeps",
          "failure port: tcp/h:99999 cannot be listened on: ports end at 65535 → set another zenoh.listen"),
    Scene("port", listens("tcp/192.0.2.1:7447", "tcp/198.51.100.7:7447"), *(f"failure port: {each} is not there … nor "
          "any … nobody can reach it → set zenoh.listen" for each in ("tcp/192.0.2.1:7447", "tcp/198.51.100.7:7447"))),
    *(Scene("certificates", named(host), "ok", line, patch={"socket.gethostname": lambda: "Robot.lan"})
      for host, line in (("robot.local", "ok"), ("192.0.2.1", "warning … is for 192.0.2.1, and this robot is Robot: "),
                         ("old.local", "warning … --dir DIR --host Robot.local, and copy gateway.pem here"))),
    Scene("access control", access(str), "ok access control: lets all"),
    Scene("access control", access(lambda text: text.replace(f', "{CALIBRATION}"', "")), "warning access control … "
          "drops messages: watching, telemetry, asking for reports, reports as an answer → … sudo "
          "hexapod-gateway setup"),
    Scene("access control", access(lambda text: text.replace('["commands",', "[")), "drops messages: commands →"),
    Scene("access control", access(lambda text: text.replace('"put", "delete", "query"]', '"put", "query"]', 1)),
          "silently drops messages: commands →"),
    Scene("access control", access(lambda text: re.sub(r'"id": "|\["', lambda found: f"{found[0]}my ", text))),
    Scene("access control", access(lambda text: text.replace("access_control: {\n    enabled: true", "access_control: "
                                                             "{\n    enabled: false"))),
)
# fmt: on
IDS = [f"{each.name}: {(*each.lines, 'nothing')[0]}" for each in SCENES]


def is_pasted(fix: str) -> None:
    """Check that a remedy's text from its first `sudo` on is shell alone."""
    if found := re.search(r"\bsudo .*", fix):
        bare = re.sub(r"\$?'[^']*'", "X", found[0])
        assert not set("()[]`").intersection(bare), fix
        for each in re.split(r" *(?:;|&&|\|\||\|) *", bare):
            assert each.split()[0] in ("sudo", "sort", "tail"), fix
            assert not re.search(r",( |$)| (or|then|and|with|if)( |:|$)", each), fix


@pytest.mark.parametrize("planted", SCENES, ids=IDS)
def test_what_is_planted_is_a_line(planted: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each expected line has its parts, with … between, in this order. A remedy's commands are this program's."""
    looked_at = planted.plant(tmp_path)
    for name, value in planted.patch.items():
        monkeypatch.setattr(name, value)
    lines = [each for each in results(looked_at, *planted.probes) if each.name == planted.name]
    monkeypatch.undo()
    found = [f"{each.verdict} {each.name}: {each.sentence} → {each.fix}" for each in lines]
    assert len(found) == len(planted.lines), found
    for line, parts in zip(found, planted.lines, strict=True):
        at = 0
        for part in parts.split(" … "):
            assert part in line[at:], (part, line)
            at = line.index(part, at)
    for each in lines:
        assert (each.verdict is Verdict.OK) is (each.fix == ""), each
        parse_commands(each.fix)
        is_pasted(each.fix)


@pytest.mark.parametrize(("plant", "sentence"), PLANTED, ids=[sentence for _, sentence in PLANTED])
def test_each_fault_of_an_installation_is_one_line(
    plant: Plant, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lines about this machine are left out: its users, and a folder that a boot empties."""
    robot = Installed(tmp_path)
    plant(robot)
    monkeypatch.setattr(whole, "compare", lambda: robot.files)
    monkeypatch.setattr(whole, "version", lambda: robot.version)
    monkeypatch.setattr(whole, "status", lambda: robot.status)
    found = [each for each in results(robot, *AS_ROOT, installation.unit) if each.verdict is not Verdict.OK]
    lines = [each for each in found if each.name != "user" and "which a boot empties" not in each.sentence]
    assert len(lines) == bool(sentence), lines
    for line in lines:
        is_pasted(line.fix)
        assert sentence in line.sentence
        assert "sudo " in line.fix or "systemctl cat" in line.fix


def test_a_missing_python_can_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "can", None)
    (line,) = results(SLCAN(tmp_path), wire.power)
    assert "python-can is not installed" in line.sentence


def test_each_command_in_a_message_exists() -> None:
    files = [file for file in sorted(GATEWAY.rglob("*.py")) if re.search(r"hexapod-gateway |run\[", file.read_text())]
    spoken = (text for file in files for text in texts(file.read_text(), value) if text.count(" ") > 1)
    found = [words for text in spoken for words in parse_commands(text)]
    assert len(found) > 40


def value(shown: ast.expr) -> str:
    """Return 7, but for a wire its name."""
    return SpiProtocol.ELKAPOD_2025 if re.search(r"wire\.name|SpiProtocol", ast.unparse(shown)) else "7"


# ---- currents


@pytest.mark.parametrize(
    ("moving", "says"),
    [
        ({"11": 0.009, "12": 0.008, "61": 0.4}, "output for servo 61 feeds it (392 mA"),
        ({"11": 0.009, "12": 0.4, "61": 0.008}, "feeds another servo, or none"),
        ({"61": 0.04}, "has measured no current of servo 61"),
        ({}, "has measured no current of servo 61"),
    ],
)
def test_the_highest_currents_show_which_output_feeds_a_servo(moving: dict[str, float], says: str) -> None:
    def report(amperes: dict[str, float | None]) -> Telemetry:
        servos = {name: ServoTelemetry(supplied=True, current_a=each) for name, each in amperes.items()}
        return Telemetry(time=dt.datetime.now(dt.UTC), age_ms=0, servos=servos)

    rest = [report({"11": 0.008, "12": 0.008, "61": 0.008}), report({"61": 0.003, "12": None})]
    assert says in output(rest, [report(dict(moving)), report(dict.fromkeys(moving, 0.001))], 61)


# ---- who has it


def test_who_has_a_file_or_port_is_named_with_its_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that listens on all addresses is named, too; one on another address or port is not."""
    monkeypatch.setattr(os, "getpid", lambda: 0)  # or a process would leave itself out
    device, own = tmp_path / "device", int(os.readlink("/proc/self"))
    with device.open("w"), socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("", 0)) as every:
        port, ports, found = one.getsockname()[1], every.getsockname()[1], OpenFiles()
        for holders in (
            found.holders(str(device)),
            *(found.listeners(f"tcp/{host}:{port}") for host in ("127.0.0.1", "localhost", "0.0.0.0", "[::]")),  # noqa: S104
            *(found.listeners(f"tls/{host}:{ports}") for host in ("127.0.0.1", "127.0.0.2")),
        ):
            assert [each.pid for each in holders] == [own]
            assert f"(process {own}" in str(holders[0])
        for nobodys in (f"tcp/127.0.0.2:{port}", f"udp/127.0.0.1:{port}", "tcp/127.0.0.1:1", "unixsock-stream/x"):
            assert found.listeners(nobodys) == []
