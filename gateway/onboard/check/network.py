"""Zenoh's configuration, its ports and routers, and its access control."""

import errno
import json
import logging
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, Final

import zenoh
from pydantic import ValidationError

from gateway.certs import BUTTON
from gateway.certs.access import TRAFFIC, Traffic
from gateway.certs.zenoh_files import command_for_new_rules
from gateway.errors import ConfigError, GatewayError, ZenohError
from gateway.host.sockets import listening
from gateway.onboard.check import certificates, service_user
from gateway.onboard.check.certificates import DENIED
from gateway.onboard.check.table import LET_READ, RESTART, CheckedRobot, Probe, Seen, always, failure, warning
from gateway.own_command import this_command
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Stage
from gateway.people.client.requests import Identity
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import connect_endpoints, get, listen_endpoints, one_line, open_session
from schemas.keys import ALL_COMMANDS, COMMAND_KEYS, GET_ONLY, PUBLISHED, STATE
from schemas.telemetry import GatewayState

_ANSWER_S: Final = 1.0
_LAST_PORT: Final = 65_535
_TCP, _UDP = socket.SOCK_STREAM, socket.SOCK_DGRAM
_LINKS: Final = MappingProxyType({"tcp": _TCP, "tls": _TCP, "ws": _TCP, "udp": _UDP, "quic": _UDP})
_ENDPOINT: Final = re.compile(r"(?P<link>[a-z0-9-]+)/(?P<host>\[[^\]]+\]|[^:#?\[\]]+):(?P<port>\d{1,5})(?:[#?].*)?")
_GET_ONLY_NEEDS: Final = frozenset({"query", "reply", "declare_queryable"})
_SHOWN: Final = 3


# ---- Zenoh's configuration


def configuration(robot: CheckedRobot) -> tuple[zenoh.Config | None, list[str], list[str]]:
    """What the service would open, its faults, and the warnings that it would log about it."""
    with _warnings_of("gateway") as logged:
        try:
            return service_config(robot.settings.zenoh), [], logged
        except ConfigError as error:
            return None, str(error).splitlines(), []


@contextmanager
def _warnings_of(logger_name: str) -> Iterator[list[str]]:
    """Collects the warnings logged meanwhile, which go nowhere else."""
    logged: list[str] = []

    class CollectLines(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            logged.append(record.getMessage())

    logger, handler = logging.getLogger(logger_name), CollectLines(logging.WARNING)
    propagate = logger.propagate
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield logged
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate


def _zenoh(robot: CheckedRobot) -> Iterator[Seen]:
    _, faults, logged = configuration(robot)
    well = robot.settings.zenoh.config or "its configuration is these settings alone"
    for fault in faults:
        yield Seen(fault=fault, denied=DENIED in fault)
    for line in logged or ([] if faults else [""]):
        yield Seen(fault="", logged=line, well=well)


def _listeners(robot: CheckedRobot) -> Iterator[Seen]:
    """Why Zenoh cannot listen: tried on free ports of the addresses whose own ports can be had. Nobody is dialled."""
    config = configuration(robot)[0]
    where = [seen.where for seen in ports(robot) if seen.error is None] if config is not None else []
    found = [each for each in map(_parsed, where) if each is not None]
    if config is None or not found or any(certificates.mismatched(robot)):  # of which Zenoh's sentence tells nothing
        return
    free = [f"{each.string[: each.start('port')]}0{each.string[each.end('port') :]}" for each in found]
    config.insert_json5("connect/endpoints", "[]")
    config.insert_json5("listen/endpoints", json.dumps(free))
    try:
        open_session(config).close()
    except ZenohError as error:
        yield Seen(where=", ".join(where), why=one_line(error.__cause__ or error))


def _routers(robot: CheckedRobot) -> Iterator[Seen]:
    """Whether what the gateway dials is there, as far as it can be seen without being the gateway."""
    config = configuration(robot)[0]
    if config is None:
        return
    for endpoint, findings in diagnosis.look_at_all(connect_endpoints(config), Identity.of(config)).items():
        # A port that speaks no TLS may well be a router's.
        last = next((each for each in reversed(findings) if each.stage is not Stage.GATEWAY), findings[-1])
        sentence, fix = (text.replace("the robot", "the router") for text in (last.sentence, last.fix))
        off, file = last.stage in (Stage.NAME, Stage.TCP), robot.settings.zenoh.config
        yield Seen(endpoint=endpoint, sentence=sentence, fix=fix, off=off, file=file)


# ---- ports


def ports(robot: CheckedRobot) -> list[Seen]:
    """Each endpoint that the service would listen on."""
    config = configuration(robot)[0]
    endpoints = [] if config is None else listen_endpoints(config)
    return [port(endpoint, gateway_runs=robot.gateway_runs) for endpoint in endpoints]


def _ports(robot: CheckedRobot) -> Iterator[Seen]:
    found = ports(robot)
    yield from found
    if not found and configuration(robot)[0] is not None:
        yield Seen(where="none:", error=None, well="the gateway listens nowhere, and dials others")
    metrics = robot.settings.telemetry.metrics
    if metrics:
        host, _, number = metrics.rpartition(":")
        yield _port(metrics, host, int(number), "tcp", setting="telemetry.metrics", gateway_runs=robot.gateway_runs)


def port(endpoint: str, *, gateway_runs: bool = False) -> Seen:
    """Why the service could not listen on `endpoint`; a gateway that listens there already is fine."""
    found = _parsed(endpoint)
    if found is None:
        return Seen(where=endpoint, error=None, well="was not tried: it names no port that could be")
    number, link = int(found["port"]), found["link"]
    return _port(endpoint, found["host"], number, link, setting="zenoh.listen", gateway_runs=gateway_runs)


def _port(where: str, host: str, number: int, link: str, *, setting: str, gateway_runs: bool) -> Seen:
    seen = Seen(where=where, setting=setting, error=_listen(host, number, _LINKS[link]), why="", well="is free")
    if seen.error is not None:
        seen.why = seen.error.strerror
        if seen.error.errno == errno.EADDRINUSE:
            speaks = link == "tcp" and setting == "zenoh.listen"  # TLS would demand a certificate
            state = state_at(f"tcp/{_LOOPBACK.get(host, host)}:{number}") if speaks else None
            used = "by the service" if service_user.uid() in owners(number, _LINKS[link]) else ""
            if state is not None:
                used = f"by a gateway that is {state.mode}{', on a simulated controller' if state.simulated else ''}"
            elif gateway_runs:
                used = used or "by the gateway that runs here, it seems"
            if used:
                seen.well, seen.error = f"is in use {used}", None
    return seen


_LOOPBACK: Final = MappingProxyType({"0.0.0.0": "127.0.0.1", "[::]": "[::1]"})  # noqa: S104 (dialled, not opened)


def _parsed(endpoint: str) -> re.Match[str] | None:
    found = _ENDPOINT.fullmatch(endpoint)
    return found if found is not None and found["link"] in _LINKS else None


def _listen(host: str, number: int, kind: socket.SocketKind) -> OSError | None:
    """Why nothing could listen there now; None: it could. For a name, none of its addresses may be in use."""
    if number > _LAST_PORT:  # getaddrinfo would take the lower 16 bits
        return OSError(errno.EINVAL, f"ports end at {_LAST_PORT}")
    try:
        found = socket.getaddrinfo(host.strip("[]"), number, type=kind)
    except OSError as error:
        return error
    errors = [_bind(family, kind, address) for family, _, _, _, address in found]
    taken = [error for error in errors if error is not None and error.errno == errno.EADDRINUSE]
    return taken[0] if taken else None if None in errors else errors[0]


def _bind(family: socket.AddressFamily, kind: socket.SocketKind, address: Any) -> OSError | None:
    try:
        with socket.socket(family, kind) as probe:
            if kind is socket.SOCK_STREAM:  # as the listener does: a recently closed connection is no obstacle
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            if kind is socket.SOCK_STREAM:
                probe.listen(1)
    except OSError as error:
        return error
    return None


def state_at(endpoint: str) -> GatewayState | None:
    """What answers there; None: no gateway does."""
    try:
        with Client(endpoint, source="hexapod-gateway check", timeout_s=_ANSWER_S) as client:
            return client.state()
    except (GatewayError, ValidationError):
        return None


def owners(port: int, kind: socket.SocketKind) -> set[int]:
    """The users (numbers) of the sockets that listen on a port, as the kernel shows everybody."""
    return {uid for _, uid in listening(port, kind)}


# ---- access control: what an older release's does not let through is dropped without a word on either side


def _access(robot: CheckedRobot) -> Iterator[Seen]:
    config = configuration(robot)[0]
    if config is not None:
        yield from passes(config, robot.settings.zenoh.config)


def passes(config: zenoh.Config, file: str) -> Iterator[Seen]:
    """What the access control of this Zenoh file drops of the others' messages, and of a button's."""
    if get(config, "access_control/enabled") is not True or get(config, "access_control/default_permission") != "deny":
        return
    dropped = _dropped(config)
    of_buttons = {key: each for key, each in _dropped(config, BUTTON).items() if each != dropped.get(key)}
    keys, namespace = list(dropped), get(config, "namespace")
    before = f"{namespace}/" if namespace else ""
    listener = next(
        (int(found[1]) for each in listen_endpoints(config) if (found := re.search(r":(\d+)$", each))), 7447
    )
    yield Seen(
        file=file, dropped=dropped, of_buttons=of_buttons, before=before, state=STATE,
        keys=", ".join(keys[:_SHOWN]) + (f" and {len(keys) - _SHOWN} more" if len(keys) > _SHOWN else ""),
        messages=_messages(dropped), button_messages=_messages(of_buttons),
        published={key.removeprefix(before) for key in keys} <= set(PUBLISHED),
        by_hand=", ".join(f'"{key}"' for key in keys),
        anew=f"{command_for_new_rules(file, listener, this_command())} && {RESTART}",
    )  # fmt: skip


def _messages(dropped: dict[str, list[str]]) -> str:
    return ", ".join(dict.fromkeys(message for messages in dropped.values() for message in messages))


def _dropped(config: zenoh.Config, role: str = "") -> dict[str, list[str]]:
    """The keys that something is dropped on, each with the messages that this role sends and receives, or the others.

    A button may send little, and an operator's rules must let all of it through.
    """
    namespace = get(config, "namespace") or ""
    policies = get(config, "access_control/policies") or []
    named = {
        name
        for policy in policies
        if (role in policy["subjects"] if role else policy["subjects"] != [BUTTON])
        for name in policy["rules"]
    }
    rules = [
        rule
        for rule in get(config, "access_control/rules") or []
        if rule["id"] in named and rule["permission"] == "allow"
    ]
    dropped: dict[str, list[str]] = {}
    for traffic in (each for each in TRAFFIC if (role in each.roles if role else each.roles != (BUTTON,))):
        flow = "ingress" if traffic.from_people else "egress"
        for key, message in _said(traffic):
            whole = f"{namespace}/{key}" if namespace else key
            if not any(_lets(rule, flow, message, whole) for rule in rules):
                dropped.setdefault(whole, []).append(message)
    return dropped


def _said(traffic: Traffic) -> Iterator[tuple[str, str]]:
    """Key by key: a file that was made by hand may name each."""
    for key in (*COMMAND_KEYS, *GET_ONLY) if traffic.keys == (ALL_COMMANDS,) else traffic.keys:
        for message in traffic.messages:
            if key not in GET_ONLY or message in _GET_ONLY_NEEDS:
                yield key, message


def _lets(rule: dict[str, Any], flow: str, message: str, key: str) -> bool:
    return (
        flow in (rule.get("flows") or (flow,))
        and message in rule["messages"]
        and any(zenoh.KeyExpr(each).includes(zenoh.KeyExpr(key)) for each in rule["key_exprs"])
    )


def _errno(number: int) -> Callable[[Seen], object]:
    return lambda r: r.error is not None and r.error.errno == number


# fmt: off
ZENOH: Final = Probe("Zenoh", _zenoh, (
    failure(lambda r: r.fault and r.denied, "{fault}", LET_READ),
    failure(lambda r: r.fault, "{fault}", "fix it there"),
    warning(lambda r: r.logged, "{logged}", "see docs/security.md for what each link needs"),
), "{well}")
ACCESS: Final = (
    Probe("access control", _access, (
        warning(lambda r: r.dropped and r.published,
                "{file} does not let {keys} through ({messages}): messages there are lost without a word",
                'in its rules, write {by_hand} next to each "{before}{state}", and restart; or make it anew: {anew}'),
        warning(lambda r: r.dropped,
                "{file} does not let {keys} through ({messages}): messages there are lost without a word",
                "make it anew: {anew}"),
    ), "lets all of this gateway's keys through"),
    Probe("stop buttons", _access, (
        warning(lambda r: r.of_buttons, "{file} does not let a certificate of the role button through "
                "({button_messages}): until it does, a stop button needs an operator's", "make it anew: {anew}"),
    )),
)
PORTS: Final = Probe("port", _ports, (
    failure(_errno(errno.EADDRINUSE), "{where} is taken by another program",
            "see whose it is (ss -ltnp), or set another {setting}"),
    failure(_errno(errno.EADDRNOTAVAIL), "{where} is no address of this machine",
            "set another {setting} (ip address shows them)"),
    failure(_errno(errno.EACCES), "{where} may not be listened on by this user", "set {setting} to a port above 1023"),
    failure(_errno(errno.EAFNOSUPPORT), "{where} needs IPv6, which this kernel lacks",
            "in {setting}, write 0.0.0.0 for [::]"),
    failure(lambda r: r.error, "{where} cannot be listened on: {why}", "set another {setting}"),
), "{where} {well}")
LINKS: Final = (
    Probe("Zenoh", _listeners, (
        failure(always, "cannot listen on {where}: {why}",
                "in zenoh.listen, write tls/ for tcp/, or leave it out: the Zenoh file has endpoints of its own"),
    )),
    Probe("router", _routers, (
        failure(lambda r: r.fix and r.off, "{endpoint}: {sentence}: nobody behind it reaches this robot",
                "start it there (zenohd -c router.json5), or write others as connect.endpoints of {file}; the gateway "
                "goes on trying"),
        failure(lambda r: r.fix, "{endpoint}: {sentence}: nobody behind it reaches this robot", "{fix}"),
    ), "{endpoint}: {sentence}"),
)
# fmt: on
