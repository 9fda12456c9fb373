"""What may be wrong on a robot, as a table: how it is planted, what `check` says of it.

The remedy is not here: the test runs the commands that `check` prints. `by_hand` follows a remedy that is a sentence.
Shell, with the names of `NAMES`. The services run before each. A fault whose remedy another row runs, or which is a
sentence, is in tests/unit/onboard/test_check.py alone.
"""

from typing import NamedTuple

NAME = "hexapod-gateway"
NAMES = f"""
lib=/usr/lib/{NAME}; own=$(readlink -f $lib/current)
etc=/etc/{NAME}; toml=$etc/gateway.toml; pki=$etc/zenoh; state=/var/lib/{NAME}; service={NAME}
units=/etc/systemd/system; unit=/usr/lib/systemd/system/$service.service; rules=/usr/lib/udev/rules.d/60-$service.rules
drop_in() {{
    mkdir -p $units/$service.service.d && printf '[Service]\\n' >$units/$service.service.d/own.conf
    printf '%s\\n' "$@" >>$units/$service.service.d/own.conf
    systemctl daemon-reload
}}
set -e
"""
"""Before each shell text."""
CERTS = "/root/certs"
"""Where the folder of certificates is, as if on another machine, and one of another authority."""
OTHER = "/root/other"
PACKAGE = "/box-out/hexapod-gateway_1.1.0_amd64.deb"
GIVEN = {
    "./hexapod-gateway_VERSION_ARCH.deb": PACKAGE,
    "FOLDER": CERTS,
    "FILE": f"{CERTS}/revoked.crl",
    "./hexapod-gateway_1.1.0_ARCH.deb": PACKAGE,
}
"""What a person fills in."""


class Fault(NamedTuple):
    """A row. `plant` may restart what notices it only at its start."""

    what: str
    plant: str
    says: str
    by_hand: str = ""
    then: str = ""
    """Takes away what a remedy leaves and no person would see."""
    more: int = 0
    """How many lines come to light only after it, each with a remedy of its own."""


FAULTS = (
    # after which a crash leaves the servos on
    Fault(
        "a unit without Stops",
        "sed -i /^ExecStopPost.*stop-servos/d $unit; systemctl daemon-reload",
        f"/usr/lib/systemd/system/{NAME}.service is not this release's",
    ),
    Fault("a drop-in without Stops", "drop_in ExecStopPost=", "depend on: ExecStopPost"),
    Fault("a state directory of root's", "chown -R root:root $state", "may not read and write /var/lib"),
    # the package
    Fault(
        "an emptied file and a missing one",
        "rm $own/gateway/people/commands/decode.py; : >$own/mcap/writer.py",
        "gateway/people/commands/decode.py",
    ),
    Fault("an emptied file of check's own", ": >$own/gateway/words/text.py", "gateway/words/text.py"),
    Fault("a module that was not installed", "echo >$own/json.py", "and not installed with it: /usr/lib"),
    Fault("a file for root only", "chmod 600 $own/gateway/people/commands/decode.py", "not readable by all"),
    # user and groups
    Fault("no user", "systemctl stop $service; userdel $service", f"there is no user {NAME}"),
    # units
    Fault(
        "a unit of somebody's own",
        "sed /^ExecStopPost/d $unit >$units/$service.service; systemctl daemon-reload; systemctl restart $service",
        f"/etc/systemd/system/{NAME}.service is not this",
    ),
    Fault("a unit that was edited only", "echo '# edited' >>$unit", f"{NAME} was edited, but systemd still", more=1),
    Fault(
        "a masked unit",
        "systemctl stop $service; systemctl mask $service",
        f"/etc/systemd/system/{NAME}.service is not this",
    ),
    Fault("a stopped service", "systemctl stop $service", "is enabled and inactive"),
    # drop-ins
    Fault(
        "a simulated controller left",
        "drop_in Environment=GATEWAY_OPTIONS=--sim ExecStopPost=; systemctl restart $service",
        "makes the controller a simulated one",
    ),
    Fault(
        "a variable for all services",
        "systemctl set-environment HEXAPOD_LIMITS__LEG_RATE_HZ=20; systemctl restart $service",
        "HEXAPOD_LIMITS__LEG_RATE_HZ is in the service's environment",
    ),
    Fault(
        "forty kills",
        "for each in $(seq 40); do systemctl kill --signal=KILL $service || :; systemctl start $service || :; done\n"
        "! systemctl start $service 2>/root/refused; systemctl is-failed $service\n"
        "grep 'systemctl status' /root/refused\n"
        "systemctl status $service | head -1 | grep 'sudo hexapod-gateway check'",
        "has failed",
    ),
    # the state directory
    Fault(
        "a state directory on a read-only file system",
        "mount --bind $state $state; mount -o remount,bind,ro $state",
        "is mounted read-only",
        then="systemctl stop $service; umount $state; systemctl start $service",
    ),
    Fault(
        "a state directory that is a file",
        "systemctl stop $service; mv $state /root/kept; touch $state",
        "is no folder",
        then="rm -rf $state $state.old; mv /root/kept $state; systemctl restart $service",
    ),
    Fault(
        "a damaged calibration",
        "echo '{' >$state/calibration.toml; chown $service $state/calibration.toml; systemctl restart $service",
        "nothing can be started",
        by_hand='echo \'{"revision": 0, "servos": {}, "landing": {}}\' | '
        "hexapod-gateway calibrate import - --yes --zenoh-config /root/certs/anna.json5",
        then="rm $state/calibration.toml; systemctl restart $service",
    ),
    Fault(
        "a full disk",
        "systemctl stop $service; mount -t tmpfs -o size=24m none $state; chown $service: $state\n"
        "head -c 23M /dev/zero >$state/films; systemctl start $service",
        "/var/lib/hexapod-gateway has ",
        by_hand="rm $state/films; systemctl stop $service; umount $state; systemctl start $service",
    ),
    # what restarts the service
    Fault(
        "needrestart without the package's exception",
        "rm -f /etc/needrestart/conf.d/$service.conf; ln -s /bin/true /usr/sbin/needrestart",
        "needrestart restarts the service",
        then="rm /usr/sbin/needrestart",
    ),
    Fault(
        "reboots by unattended-upgrades",
        "echo 'Unattended-Upgrade::Automatic-Reboot \"true\";' >/etc/apt/apt.conf.d/50own",
        "unattended-upgrades reboots this machine",
        then="rm /etc/apt/apt.conf.d/50own /etc/apt/apt.conf.d/99-no-reboot",
    ),
    # the device
    Fault("no udev rule", "rm $rules", "60-hexapod-gateway.rules"),
    Fault(
        "a device that another program has locked",
        "systemctl stop $service; setsid flock $(readlink -f /dev/spidev0.0) sleep 999 >/dev/null 2>&1 & sleep 1",
        "is held by flock",
    ),
    Fault(
        "a node for root only",
        "chgrp root /dev/spidev0.0; chmod 600 /dev/spidev0.0",
        "/dev/spidev0.0 may not be opened",
    ),
    Fault(
        "a device that does not exist",
        "sed -i '1i spi.device = \"/dev/spidev9.9\"' $toml; systemctl restart $service || true",
        "/dev/spidev9.9: No such file or directory → set spi.device; this machine has /dev/spidev0.0",
        by_hand="cp /root/gateway.toml $toml; systemctl reset-failed $service; systemctl restart $service",
    ),
    # two releases, and a removal that was cut off
    Fault(
        "an upgrade that failed its trial",
        "sed -i '1i limits.x = 1' $toml; ! dpkg --install /box-out/hexapod-gateway_1.1.1_amd64.deb\n"
        "cp -p /root/gateway.toml $toml",
        "limits.x: is no setting. So 1.1.0 goes on, and each apt command repeats the error",
        then=f"dpkg --install {PACKAGE}",
    ),
    Fault(
        "a removal that was cut off",
        "echo 'kill -KILL $PPID' >>/var/lib/dpkg/info/$service.prerm; ! dpkg --remove $service",
        "1.1.0 is only partly installed",
    ),
    # ports and addresses
    Fault(
        "another program on the port",
        "systemctl stop $service; setsid python3 -c \"import socket, time; at = '127.0.0.1', 7447\n"
        'each = socket.create_server(at); time.sleep(999)" >/dev/null 2>&1 & sleep 1\n'
        "systemctl --no-block start $service",
        "tls/127.0.0.1:7447 is held by python3",
    ),
    Fault(
        "addresses that this machine does not have",
        "sed -i 's/127.0.0.1/192.0.2.9/' $toml; systemctl restart $service",
        "nor any other endpoint: the service runs, and nobody can reach it",
        by_hand="cp -p /root/gateway.toml $toml; systemctl restart $service",
    ),
    Fault(
        "a disk for the state that is not mounted",
        "mkdir /root/disk; cp -a $state/. /root/disk; chown $service: /root/disk\n"
        "printf '/root/disk %s none bind\\n' $state >>/etc/fstab",
        "/root/disk is not mounted on /var/lib/hexapod-gateway",
        then="systemctl stop $service; umount $state; sed -i /root.disk/d /etc/fstab; systemctl daemon-reload\n"
        "systemctl start $service",
    ),
    Fault(
        "a disk for the state that is not there",
        "cp /etc/fstab /root/fstab; printf '/dev/none %s ext4 nofail\\n' $state >>/etc/fstab",
        "/dev/none is not mounted on /var/lib/hexapod-gateway",
        by_hand="cp /root/fstab /etc/fstab",
    ),
    Fault(
        "IPv6 switched off",
        "mkdir /root/proc; mount -t proc proc /root/proc; ipv6=/root/proc/sys/net/ipv6/conf/all/disable_ipv6\n"
        "echo 1 >$ipv6; sed -i 's/127.0.0.1/[::1]/' $toml; systemctl restart $service",
        "nor any other endpoint: the service runs, and nobody can reach it",
        by_hand="echo 0 >/root/proc/sys/net/ipv6/conf/all/disable_ipv6; umount /root/proc; systemctl restart $service",
        then="cp -p /root/gateway.toml $toml; systemctl restart $service",
    ),
    # the configuration
    Fault(
        "a configuration in UTF-16",
        "iconv --to-code=UTF-16 /root/gateway.toml >$toml",
        "is no text in UTF-8: saved in another encoding (UTF-16), or damaged by a power cut → put a copy of it there",
        by_hand="cp -p /root/gateway.toml $toml",
    ),
    Fault(
        "a configuration for root only", "chown root:root $toml; chmod 600 $toml", "cannot be read (Permission denied)"
    ),
    # certificates
    Fault(
        "the authority's key by another name",
        "install -g $service -m 640 /root/certs/ca.key $pki/old.key",
        "old.key is the authority's key",
    ),
    Fault("a private key that all may read", "chmod 644 $pki/gateway.key", "not only root and the service may read"),
    Fault(
        "a robot that was renamed",
        f"hexapod-gateway certs issue old --role robot --host old.local --dir {CERTS}; cp {CERTS}/old/gateway.* $pki\n"
        "systemctl restart $service",
        "is for old.local, and this robot is",
        by_hand=f"cp {CERTS}/gateway.* $pki; systemctl restart $service",
    ),
    Fault("the key of another", "cp /root/other/gateway.key $pki", "gateway.key is not the key of"),
    Fault("a damaged list of the revoked", "echo x >$state/revoked.crl", "this is no list of"),
)
