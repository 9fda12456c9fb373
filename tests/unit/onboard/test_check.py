"""`check`: what is planted on a machine, and the line that it prints. Each row of its table is reached here."""

import ast
import os
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from gateway import certs, durable
from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.model.protocols import WITH_UART
from gateway.onboard.check import installation, security, table, wire
from gateway.onboard.check.table import CheckedRobot, Probe, Result, Seen, Verdict, results
from gateway.robot.host import calibration_file
from gateway.robot.host.calibration_file import SLOW_S
from gateway.robot.settings import Settings
from schemas.keys import CALIBRATION
from tests.box import faults
from tests.support.certs_folder import DAY, NOW, make_folder
from tests.support.gateway_process import dialling
from tests.support.machine_tree import PI_4, MachineTree
from tests.support.remedies import parse_commands, texts
from tests.unit.onboard.test_check_installation import PLANTED, Installed

__all__ = ["make_folder"]  # a fixture
MODULES = (installation, security, wire)
GATEWAY = Path(certs.__file__).parents[1]
LENGTH: dict[str, Any] = {"framing": "length-prefixed"}


def flat(value: object) -> list[Probe]:
    """The probes in one of a module's values."""
    if isinstance(value, Probe):
        return [value]
    return [each for each in value if isinstance(each, Probe)] if isinstance(value, tuple) else []


PROBES = list(dict.fromkeys(probe for module in MODULES for value in vars(module).values() for probe in flat(value)))
"""The whole table."""


def named(name: str, place: int = 0) -> Probe:
    """The probe of this name; of several, in the order of the modules."""
    return [each for each in PROBES if each.name == name][place]


def compare(lines: list[Result], expected: tuple[str, ...]) -> None:
    """Each expected line has its parts, with … between, in this order. A remedy's commands are this program's."""
    found = [f"{each.verdict} {each.name}: {each.sentence} → {each.fix}" for each in lines]
    assert len(found) == len(expected), found
    for line, parts in zip(found, expected, strict=True):
        at = 0
        for part in parts.split(" … "):
            assert part in line[at:], (part, line)
            at = line.index(part, at)
    for each in lines:
        assert (each.verdict is Verdict.OK) is (each.fix == ""), each
        assert "{" not in each.fix.replace("FOLDER/{", ""), each
        parse_commands(each.fix)


def robot(root: Path, *, gateway_runs: bool = False, **sections: Any) -> CheckedRobot:
    return CheckedRobot(Settings.of(sections), root, lambda *_: {}, gateway_runs)


# ---- judged: facts in place of a reading

UNIT = {"systemd": True, "load": "loaded", "active": "active", "enabled": "enabled", "result": "exit-code"}
UNIT |= {"program": "", "stops": True}
PRIORITY = {"running": None, "rejected": "", "limit": 0, "priority": 20, "to": "it"}
WIRE = {"lack": "", "denied": False, "path": "/dev/x", "user": "me", "rights": "r", "group": None, "service": False}
WIRE |= {"absent": "plug it in", "error": "", "opens": "opens", "console": "", "login": "", "held": "", "tty": "ttyS0"}
WIRE |= {"kind": "ttyS", "locked": ""}
BOARD = {**WIRE, "simulated": False, "off": False, "bitrate": 10**6, "silent": False}
BOARD |= {"answers": "answers", "where": "slcan x"}
STATE_FOLDER = {"is_folder": True, "own": True, "kind": "ext4", "some": ""}
DISK = {"read_only": False, "mount": "/mnt", "free_mb": 999, "inodes": 999}
PORT = {"where": "tcp/h:1", "setting": "zenoh.listen", "why": "?", "taken": False, "late": False}
PAIR = {"certificate": "/c.pem", "key": "/c.key", "ca": "/ca.pem", "files": "a, b, c", "foreign": False}
PAIR |= {"other_key": False, "listens": True, "role": "gateway", "here": True, "hosts": "a.local", "host": "b"}


class Fact(NamedTuple):
    """A reading: `facts`, and else what is `usual`."""

    probe: Probe
    usual: Mapping[str, Any]
    facts: Mapping[str, Any]
    line: str


def facts(probe: Probe, usual: Mapping[str, Any], *rows: tuple[Mapping[str, Any], str]) -> list[Fact]:
    return [Fact(probe, usual, each, line) for each, line in rows]


# fmt: off
FACTS = (
    *facts(installation.USER, {},
           ({"root": True, "own": False}, "warning user: all this is checked as root … SETUID"),
           ({"root": False, "own": False}, "warning user: all this is checked as you … → sudo hexapod-gateway check"),
           ({"root": False, "own": True}, "ok user: all this is checked as hexapod-gateway")),
    *facts(installation.CLOCK, {},
           ({"adjtimex": 0}, "ok clock: is synchronised"),
           ({"adjtimex": 4}, "ok clock: is synchronised"),
           ({"adjtimex": 5}, "warning clock: is not synchronised → switch time synchronisation on")),
    *facts(installation.UNIT, UNIT,
           ({}, "ok systemd unit: is enabled and active"),
           ({"systemd": None}, "warning … does not run systemd"),
           ({"load": ""}, "warning … systemctl shows nothing about it"),
           ({"program": "/x/y"}, "failure … /x/y cannot be run: the service cannot start, nor stop … sudo apt install"),
           ({"stops": False}, "failure … runs no stop-servos after its end"),
           ({"active": "inactive"}, "warning … → sudo systemctl start hexapod-gateway"),
           ({"enabled": "disabled"}, "warning … → sudo systemctl enable --now hexapod-gateway"),
           ({"active": "failed"}, "failure … has failed (exit-code) → journalctl -u … sudo systemctl reset-failed"),
           ({"load": "not-found"}, "warning … is not installed … → sudo apt install"),
           ({"load": "bad-setting"}, "failure … cannot be loaded (bad-setting)")),
    *facts(named("real-time"), PRIORITY,
           ({"running": 20}, "ok real-time"),
           ({"running": 0}, "warning real-time: the running service was granted none"),
           ({"rejected": "no"}, "priority 20 is not granted (no; RLIMIT_RTPRIO is 0)")),
    *facts(wire.PLUGIN, {"name": "x", "error": "", "can": "Board, servos one by one"},
           ({}, "ok wire: x opens: Board, servos one by one"),
           ({"error": "x: no such device"}, "failure wire: x: no such device → read what the plug-in needs")),
    *facts(wire.DEVICE, WIRE,
           ({"lack": "cannot be looked at (no)"}, "failure SPI device: /dev/x cannot be looked at (no)"),
           ({"denied": True, "service": True}, "me may not open /dev/x (r) → sudo chgrp spi /dev/x && sudo chmod"),
           ({"denied": True, "group": "spi"}, "→ sudo usermod -aG spi me"),
           ({"denied": True}, "→ until the next boot: sudo chown me /dev/x"),
           ({"locked": "vi (process 7)"}, "failure … /dev/x is locked by vi (process 7), not by a gateway")),
    *facts(wire.CONTROLLER[0], WIRE,
           ({"denied": True, "service": True}, "→ sudo chgrp dialout /dev/x"),
           ({"console": True}, "failure UART: /dev/x is the Linux console"),
           ({"login": True}, "failure UART: /dev/x has a login terminal … setup --wire elkapod-2025"),
           ({"held": True}, "failure UART: /dev/x is held by another program"),
           ({"service": True}, "warning UART: /dev/x opens, but the unit lets the service open ttyAMA… only → sudo "
            "systemctl edit hexapod-gateway, with [Service] DeviceAllow=char-ttyS rw"),
           ({"service": True, "tty": "ttyAMA1"}, "ok UART: /dev/x opens")),
    *facts(wire.CONTROLLER[1], {"ms": 300, "beats": 0},
           ({"bytes": 7}, "failure heartbeat: none came in 300 ms, but 7 other bytes → see that the controller")),
    *facts(wire.POWER, BOARD,
           ({"denied": True, "service": True}, "→ sudo chgrp dialout /dev/x"),
           ({"error": "e"}, "failure power board: e → see dmesg"),
           ({"silent": True}, "failure power board: slcan x opens, and the board does not answer → press its power")),
    *facts(security.PORTS, PORT,
           ({"late": True}, "warning port: tcp/h:1 is not there yet (?): the service keeps trying"),
           ({"taken": True}, "failure port: tcp/h:1 is taken by another program"),
           ({}, "failure port: tcp/h:1 cannot be listened on: ? → set another zenoh.listen")),
    *facts(security.ZENOH, {"fault": "x", "logged": ""},
           ({"fault": "x: Permission denied"}, "failure Zenoh: x: Permission denied → let the service … sudo chown")),
    *facts(security.CERTIFICATES[0], {"fault": "x", "early": False, "left_days": 99},
           ({"fault": "x: Permission denied"}, "failure … → let the service read it")),
    *facts(security.CERTIFICATES[1], PAIR,
           ({"foreign": True}, "/c.pem is of another authority than /ca.pem … sudo hexapod-gateway setup --certs"),
           ({"other_key": True}, "failure certificates: /c.key is not the key of /c.pem: nobody can connect"),
           ({"role": "operator"}, "failure certificates: /c.pem is of operator, not of a robot: laptops reject it"),
           ({"here": False}, "warning … is for a.local, but this machine is b: is it another robot's?")),
    *facts(security.CERTIFICATES[2], {"path": "/l"},
           ({"fault": "x", "foreign": False}, "failure revoked: x; the service does not start → copy … FILE /l &&"),
           ({"fault": "", "foreign": True}, "warning revoked: /l is of another authority, so it shuts nobody out")),
    *facts(wire.CALIBRATION, {"hidden": True, "path": "/p"}, ({}, "warning … you may not read /p")),
    *facts(named("user", 1), {"missing": "group spi"}, ({}, "user: there is no group spi … sudo systemd-sysusers")),
    *facts(named("state"), STATE_FOLDER,
           ({"kind": "overlay"}, "warning … is on overlay, which a boot empties")),
    *facts(named("disk"), DISK,
           ({"read_only": True}, "/mnt is mounted read-only … sudo mount -o remount,rw /mnt"),
           ({"free_mb": 3}, "failure disk: /mnt has 3 MB free … sudo journalctl --vacuum-size=50M"),
           ({"inodes": 9}, "failure disk: /mnt has room for 9 files … sudo du -x --inodes /mnt")),
    *facts(named("Wi-Fi"), {"wifi": "wlan0"}, ({"saves": True}, "warning Wi-Fi: wlan0 saves power … sudo tee")),
)
# fmt: on


@pytest.mark.parametrize("fact", FACTS, ids=lambda fact: fact.line)
def test_a_fact_is_judged(fact: Fact) -> None:
    compare(list(fact.probe.judged(Seen(**{**fact.usual, **fact.facts}))), (fact.line,))


# ---- planted: files of a machine, and settings


class Scene(NamedTuple):
    """`plant` returns what the probes look at."""

    probes: tuple[Probe, ...]
    plant: Callable[[Path], object]
    lines: tuple[str, ...]


def scene(probe: Probe | tuple[Probe, ...], plant: Callable[[Path], object], *lines: str) -> Scene:
    return Scene((probe,) if isinstance(probe, Probe) else probe, plant, lines)


def here(tree: Mapping[str, Any] | None = None, **sections: Any) -> Callable[[Path], CheckedRobot]:
    """Settings, and a machine with this tree."""

    def plant(root: Path) -> CheckedRobot:
        if tree is not None:
            MachineTree(root, **tree)
        return robot(root, **sections)

    return plant


def dials(root: Path) -> CheckedRobot:
    return robot(root, zenoh={"listen": [], "config": dialling(root, "tcp/127.0.0.1:1")})


def neighbours(*drivers: str) -> Callable[[Path], CheckedRobot]:
    def plant(root: Path) -> CheckedRobot:
        tree = MachineTree(root)
        for place, driver in enumerate(drivers, 1):
            tree.add(f"spi0.{place}", driver)
        return robot(root)

    return plant


def files(contents: Mapping[str, str], **sections: Any) -> Callable[[Path], CheckedRobot]:
    def plant(root: Path) -> CheckedRobot:
        for name, text in contents.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_text(text)
        return robot(root, **sections)

    return plant


def clocked(speed_hz: int, *lines: str, kernel_hz: int | None = None, runs: bool = False, **spi: Any) -> Scene:
    """The clock that is set, and that which the kernel gives."""

    def plant(root: Path) -> CheckedRobot:
        return robot(root, gateway_runs=runs, spi={"speed_hz": speed_hz, **spi})

    return scene(wire.BUS[2]._replace(read=lambda look: wire.speed(look, kernel_hz)), plant, *lines)


def dated(days_left: int, *lines: str) -> Scene:
    """The robot's certificate, which is good for 90 days."""

    def plant(root: Path) -> CheckedRobot:
        certs.folder.init(root / "D", ["127.0.0.1"], days=90, now=NOW)
        return robot(root, zenoh={"config": str(root / "D" / "gateway.json5")})

    def read(look: CheckedRobot) -> list[Seen]:
        return list(security.expiries(look, NOW + (90 - days_left) * DAY))[1:]

    return scene(security.CERTIFICATES[0]._replace(read=read), plant, *lines)


def uart(path: str, model: str) -> Callable[[Path], CheckedRobot]:
    return here({"model": model}, wire={"name": "elkapod-2025"}, controller={"uart": path})


def built(version: str) -> Callable[[Path], CheckedRobot]:
    """A kernel of a Raspberry Pi 5."""
    node = "axi/pcie@120000/rp1/spi@50000"
    return here({"driver": "dw_spi_mmio", "model": PI_5, "node": node, "version": f"{PI_4}{version}\n"})


def kept(
    calibration: RobotCalibration | str, *, staged_s: float | None = None, **sections: Any
) -> Callable[[Path], CheckedRobot]:
    """A calibration, and a newer one that began to be written so long ago."""

    def plant(root: Path) -> CheckedRobot:
        path = root / "calibration.toml"
        if isinstance(calibration, str):
            path.write_text(calibration)
        else:
            calibration_file.write(path, calibration)
        if staged_s is not None:
            durable.staged_for(path).touch()
            os.utime(durable.staged_for(path), (time.time() - staged_s,) * 2)
        return robot(root, state={"path": str(root)}, **sections)

    return plant


def access(change: Callable[[str], str]) -> Callable[[Path], CheckedRobot]:
    """An access control that differs from what this release makes."""

    def plant(root: Path) -> CheckedRobot:
        certs.folder.init(root, ["127.0.0.1"], port=7448)
        file = root / "gateway.json5"
        file.write_text(change(file.read_text()))
        return robot(root, zenoh={"config": str(file), "allow_insecure": True})

    return plant


CAN, ETHERNET = 280, 1


def interface(kind: int | None, flags: int = 0) -> Callable[[Path], CheckedRobot]:
    """A network interface in the kernel's files."""
    tree = {"sys/class/net/can7/type": f"{kind}\n", "sys/class/net/can7/flags": f"{flags:#x}\n"}
    return files({} if kind is None else tree, power={"interface": "socketcan", "channel": "can7"})


def by_hand(text: str) -> str:
    return re.sub(r'"id": "|\["', lambda found: f"{found[0]}my ", text)


CARRIER, NEIGHBOURS, _ = wire.BUS
FRAMING, LISTS = wire.FRAMES
KEPT = wire.CALIBRATION
PI_5 = "Raspberry Pi 5 Model B Rev 1.0"
RENEW = (
    "where ca.key is: hexapod-gateway certs renew gateway --dir DIR, and copy gateway.pem here, then: sudo systemctl"
)
TAKES = "an emergency stop takes {} ms to write"
CPU = "sys/devices/system/cpu/cpu0/cpufreq/scaling_"
# fmt: off
SCENES = (
    scene(CARRIER, here({}), "ok SPI controller: Raspberry Pi 4 Model B Rev 1.4, Linux 6.6.31+rpt-rpi-v8, driver "
          "spi-bcm2835, chip select is a GPIO →"),
    scene(CARRIER, here({"cs_gpios": None}), "the controller drives chip select"),
    scene(CARRIER, here(), "ok … : a computer without a device tree, Linux of unknown release, driver unknown →"),
    scene(CARRIER, built("#1 SMP Debian 1:6.6.31-1+rpt1 (2024-05-29)"), "warning … a kernel of 2024-05-29. Before"),
    scene(CARRIER, built("#1 SMP Debian 1:6.6.74-1 (2025-02-04)"), "warning … a kernel of 2025-02-04"),
    scene(CARRIER, built("#1 SMP Debian 1:6.6.74-1 (2025-02-05)"), "ok … Raspberry Pi 5"),
    scene(CARRIER, built("#1 SMP PREEMPT Wed Mar 19 11:03:01 GMT 2025"), "ok … driver dw_spi_mmio"),
    scene(CARRIER, built("#1 SMP PREEMPT"), "warning … a kernel that was built at an unknown time … update the kernel"),
    scene(CARRIER, here({"driver": "dw_spi_mmio", "model": "StarFive VisionFive 2"}), "ok SPI controller: StarFive"),
    scene(NEIGHBOURS, here({}), "ok SPI bus: no other driver uses it"),
    scene(NEIGHBOURS, neighbours("fb_st7789v"), "warning SPI bus: shared with spi0.1 (driver fb_st7789v): … 2 ms"),
    scene(NEIGHBOURS, neighbours("fb_st7789v", "mcp251x"), "st7789v), spi0.2 (driver mcp251x): an"),
    clocked(2_500_000, f"ok … {TAKES.format('0.6')}"),
    clocked(2_500_001, "warning … set spi.speed_hz = 2500000 or less, or measure"),
    clocked(50_000, "ok"),
    clocked(10_000, "warning … is slow … set spi.speed_hz = 2500000"),
    clocked(2_500_000, "ok … the kernel gives 2.5 MHz", kernel_hz=125_000_000),
    clocked(2_500_000, "warning … the kernel gives 2.5 MHz … set spi.speed_hz = 2499999 or", kernel_hz=2_499_999),
    clocked(2_500_000, "ok", kernel_hz=2_500_000, runs=True),
    clocked(2_500_000, "warning … another program has set it … sudo systemctl", kernel_hz=20_000_000, runs=True),
    clocked(2_500_000, "warning … gives 0.01 MHz … sudo systemctl restart", kernel_hz=10_000, runs=True),
    clocked(2_500_000, TAKES.format("1.0"), **LENGTH),
    clocked(2_500_000, TAKES.format("12.4"), **LENGTH, frame_gap_us=1000),
    clocked(2_500_000, TAKES.format("1.4"), **LENGTH, kernel_hz=1_000_000),
    clocked(1_000_000, TAKES.format("1.0")),
    scene(LISTS, here({}), "ok SPI lists: chip select is a GPIO"),
    scene(LISTS, here({"cs_gpios": None}), "warning … whether spi-bcm2835 releases … hexapod-gateway check --move"),
    scene(LISTS, here({"cs_gpios": None}, spi=LENGTH), "ok SPI lists: spi-bcm2835 may keep chip select"),
    scene(LISTS, here(), "warning SPI lists: it is unknown whether this driver"),
    scene(FRAMING, here(), "warning framing: plain, … with it the published STM32 firmware hangs"),
    scene(FRAMING, here(spi=LENGTH), "ok framing: length-prefixed, … angles from 1 up to 4 degrees are never sent"),
    scene((*wire.FRAMES,), here(wire={"name": "elkapod-2025"})),
    scene(wire.DEVICE, here(spi={"device": "/dev/null"}), "failure SPI device: /dev/null cannot be opened"),
    scene(wire.DEVICE, here(spi={"device": "/bin/sh"}), "failure … /bin/sh is no device node → switch SPI on"),
    scene(wire.DEVICE, here(spi={"device": "/dev/none"}), "failure … /dev/none does not exist → switch SPI on"),
    scene(wire.CONTROLLER[0], uart("/none/ttyAMA1", PI_5), "does not exist → switch it on and reboot: sudo"),
    scene(wire.CONTROLLER[0], uart("/none/ttyAMA1", "Raspberry Pi 4 Model B"), "does not exist → switch a UART of"),
    scene(wire.CONTROLLER, here()),
    scene(wire.CONTROLLER[0], uart("/bin/sh", PI_5), "failure UART: /bin/sh is no device node"),
    scene(wire.CONTROLLER[0], uart("/dev/null", PI_5), "failure UART: the UART /dev/null cannot be opened"),
    scene(KEPT, kept(RobotCalibration()), "ok calibration: revision 0, servos that differ: 0 ("),
    scene(KEPT, kept(RobotCalibration(3, {11: ServoMapping(5_00)})), "revision 3, servos that differ: 1 ("),
    scene(KEPT, kept("trim = 7\n"), "failure … version is None; this gateway reads 1; nothing can be started → … "
          "hexapod-gateway calibrate accept-default"),
    scene(KEPT, kept(RobotCalibration(3), staged_s=0), "ok calibration: revision 3"),
    scene(KEPT, kept(RobotCalibration(3), staged_s=SLOW_S + 1), "warning … in force: revision 3 … restart"),
    scene(named("processor"), files({f"{CPU}governor": "powersave", f"{CPU}driver": "cpufreq-dt"}),
          "warning processor: its governor is powersave … sudo tee /etc/tmpfiles.d/"),
    scene(named("processor"), files({f"{CPU}governor": "powersave", f"{CPU}driver": "intel_pstate"})),
    scene(named("processor"), files({f"{CPU}governor": "ondemand", f"{CPU}driver": "cpufreq-dt"})),
    scene(named("memory"), files({"proc/meminfo": "MemTotal: 9 kB\nMemAvailable:   81920 kB\n"}),
          "warning memory: 80 MB are free, and the service may need 100"),
    scene(named("memory"), files({"proc/meminfo": "MemAvailable:   819200 kB\n"})),
    scene(named("supply"), files({"sys/class/hwmon/hwmon1/name": "rpi_volt\n", "sys/class/hwmon/hwmon1/in0_lcrit_alarm":
                                  "1\n"}), "warning supply: this Raspberry Pi's supply voltage is low"),
    scene(named("supply"), files({"sys/class/hwmon/hwmon1/name": "rpi_volt", "sys/class/hwmon/hwmon1/in0_lcrit_alarm":
                                  "0"})),
    dated(61, "ok certificates: … gateway.pem is good until"),
    dated(59, f"warning … days more → {RENEW}"),
    dated(1, f"warning … days more → {RENEW}"),
    dated(-1, f"failure … gateway.pem expired on … {RENEW}"),
    dated(490, "failure … gateway.pem is valid only from … set the clock (timedatectl)"),
    scene(security.CERTIFICATES[0], here(), "ok certificates: none are in use"),
    scene(security.CERTIFICATES[0], here(zenoh={"config": "/none.json5"}), "failure certificates: … /none.json5"),
    scene(security.ZENOH, here(), "ok Zenoh: its configuration is these settings alone"),
    scene(security.ZENOH, here(zenoh={"listen": ["tcp/0.0.0.0:7447"]}), "failure Zenoh … → fix it there"),
    scene(security.ZENOH, here(zenoh={"listen": ["tcp/0.0.0.0:7447"], "allow_insecure": True}),
          "warning Zenoh: … anyone who reaches tcp/0.0.0.0:7447 can move the robot"),
    scene(security.PORTS, dials,
          "ok port: none: the gateway does not listen"),
    scene(wire.POWER, here()),
    scene(wire.POWER, here(power={"interface": "slcan", "channel": "/none"}), "/none does not exist → plug"),
    scene(wire.POWER, interface(None), "failure power board: can7 is no network interface"),
    scene(wire.POWER, interface(ETHERNET, 1), "failure power board: can7 is no CAN interface"),
    scene(wire.POWER, interface(CAN, 0x40080), "can7 is switched off → … sudo tee /etc/systemd/network/80-can7"),
    scene(wire.POWER, interface(CAN, 0x40081), "failure power board: … cannot be opened"),
    scene(wire.POWER, here(power={"interface": "sim"}), "warning power board: is simulated"),
    scene(security.ACCESS, access(str), "ok access control: lets all"),
    scene(security.ACCESS, access(lambda text: text.replace(f', "{CALIBRATION}"', "")), "warning access control … drops"
          " messages: watching, telemetry, asking for reports, reports as an answer → make it anew: … "
          "--port 7448"),
    scene(security.ACCESS, access(lambda text: text.replace('["commands",', "[")), "drops messages: commands →"),
    scene(security.ACCESS, access(lambda text: text.replace('"put", "delete", "query"]', '"put", "query"]', 1)),
          "silently drops messages: commands →"),
    scene(security.ACCESS, access(by_hand)),
    scene(security.ACCESS, access(lambda text: text.replace("access_control: {\n    enabled: true", "access_control: "
                                                            "{\n    enabled: false"))),
)
# fmt: on


@pytest.mark.parametrize("planted", SCENES, ids=lambda each: f"{each.probes[0].name}: {(*each.lines, 'nothing')[0]}")
def test_what_is_planted_is_a_line(planted: Scene, tmp_path: Path) -> None:
    compare(list(results(planted.probes, planted.plant(tmp_path))), planted.lines)


def test_each_row_of_the_table_is_reached_and_its_commands_are_the_programs(tmp_path: Path) -> None:
    """Of two rows with the same texts (three devices have nodes), one is enough."""
    reached = {fault for fact in FACTS for fault in first(fact.probe, Seen(**{**fact.usual, **fact.facts}))}
    for place, planted in enumerate(SCENES):
        root = tmp_path / str(place)
        root.mkdir()
        look = planted.plant(root)
        reached |= {fault for probe in planted.probes for seen in probe.readings(look) for fault in first(probe, seen)}
    for place, (plant, _) in enumerate(PLANTED):
        planted_robot = Installed(tmp_path / f"installed {place}")
        plant(planted_robot)
        for probe in (*installation.PROBES, installation.UNIT):
            reached |= {fault for seen in probe.readings(planted_robot) for fault in first(probe, seen)}
    rows = [(probe.name, fault) for probe in PROBES for fault in probe.faults]
    texts_reached = {(fault.sentence, fault.remedy) for fault in reached}
    missed = [(name, fault) for name, fault in rows if (fault.sentence, fault.remedy) not in texts_reached]
    assert [(name, fault.sentence) for name, fault in missed] == []
    for _, fault in rows:
        parse_commands(fault.remedy)


def test_the_docs_name_the_command_that_prints_each_fault_that_a_box_tries() -> None:
    assert "`python -m tests.box.faults`" in (GATEWAY.parent / "docs/robot.md").read_text()
    assert faults.table().count("\n") >= 60


def test_each_command_that_a_message_names_is_the_programs() -> None:
    files = [file for file in sorted(GATEWAY.rglob("*.py")) if re.search(r"hexapod-gateway |run\[", file.read_text())]
    spoken = (text for file in files for text in texts(file.read_text(), value) if text.count(" ") > 1)
    found = [words for text in spoken for words in parse_commands(text)]
    assert len(found) > 50


def value(shown: ast.expr) -> str:
    """7, but for the name of a wire."""
    return WITH_UART if "WITH_UART" in ast.unparse(shown) else "7"


def first(probe: Probe, seen: Seen) -> list[table.Fault]:
    found = next((fault for fault in probe.faults if fault.when(seen)), None)
    return [] if found is None else [found]
