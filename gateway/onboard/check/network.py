"""Zenoh's configuration, its ports, and its access control."""

import errno
import logging
import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from typing import Any, Final

import zenoh
from pydantic import ValidationError

from gateway.certs import BUTTON
from gateway.certs.access import TRAFFIC, Traffic
from gateway.certs.zenoh_files import command_for_new_rules
from gateway.endpoints import host_and_port
from gateway.errors import ConfigError, GatewayError
from gateway.host.sockets import listening
from gateway.onboard.check import service_user
from gateway.onboard.check.certificates import DENIED
from gateway.onboard.check.table import LET_READ, RESTART, CheckedRobot, Probe, Seen, failure, warning
from gateway.own_command import this_command
from gateway.people.client.blocking import Client
from gateway.robot.zenoh_io.late_addresses import bind_fault, is_late
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import get, listen_endpoints
from schemas.keys import ALL_COMMANDS, COMMAND_KEYS, GET_ONLY
from schemas.telemetry import GatewayState

_ANSWER_S: Final = 1.0
_LAST_PORT: Final = 65_535
_NO_PORT: Final = OSError(errno.EINVAL, f"ports end at {_LAST_PORT}")  # getaddrinfo would take the lower 16 bits
_GET_ONLY_NEEDS: Final = frozenset({"query", "reply", "declare_queryable"})
_SHOWN: Final = 3


def configuration(robot: CheckedRobot) -> tuple[zenoh.Config | None, list[str], list[str]]:
    """What the service would open, its faults, and the warnings that it would log about it."""
    logger, logged, handler = logging.getLogger("gateway"), list[str](), logging.Handler(logging.WARNING)
    handler.emit = lambda record: logged.append(record.getMessage())  # type: ignore[method-assign]
    propagate, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        return service_config(robot.settings.zenoh), [], logged
    except ConfigError as error:
        return None, str(error).splitlines(), []
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate


def _zenoh(robot: CheckedRobot) -> Iterator[Seen]:
    _, faults, logged = configuration(robot)
    well = robot.settings.zenoh.config or "its configuration is these settings alone"
    yield from (Seen(fault=each, denied=DENIED in each) for each in faults)
    yield from (Seen(fault="", logged=each, well=well) for each in logged or ([] if faults else [""]))


# ---- ports


def _ports(robot: CheckedRobot) -> Iterator[Seen]:
    """Each endpoint that the service would listen on."""
    config = configuration(robot)[0]
    endpoints = [] if config is None else listen_endpoints(config)
    yield from (port(each, gateway_runs=robot.gateway_runs) for each in endpoints)
    if config is not None and not endpoints:
        yield Seen(where="none:", taken=False, late=False, why="", well="the gateway listens nowhere, and dials others")
    if metrics := robot.settings.telemetry.metrics:
        yield port(f"tcp/{metrics}", "telemetry.metrics", gateway_runs=robot.gateway_runs)


def port(endpoint: str, setting: str = "zenoh.listen", *, gateway_runs: bool = False) -> Seen:
    """Why the service could not listen on `endpoint`; a gateway that listens there already is fine."""
    number = host_and_port(endpoint)[1]
    fault = bind_fault(endpoint) if not number.isdecimal() or int(number) <= _LAST_PORT else _NO_PORT
    well = "is free" if number.isdecimal() else "was not tried: it names no port"
    seen = Seen(where=endpoint, setting=setting, why=fault and fault.strerror, late=fault and is_late(fault), well=well)
    seen.taken = fault is not None and fault.errno == errno.EADDRINUSE
    kind = socket.SOCK_DGRAM if endpoint.startswith(("udp/", "quic/")) else socket.SOCK_STREAM
    if seen.taken and (gateway_runs or service_user.uid() in owners(int(number), kind)):
        seen.well, seen.taken, seen.why = "is in use by the gateway that runs here", False, ""
    return seen


def state_at(endpoint: str) -> GatewayState | None:
    """What answers there; None: no gateway does."""
    with (
        suppress(GatewayError, ValidationError),
        Client(endpoint, source="hexapod-gateway check", timeout_s=_ANSWER_S) as client,
    ):
        return client.state()
    return None


def owners(port: int, kind: socket.SocketKind) -> set[int]:
    """The users (numbers) of the sockets that listen on a port, as the kernel shows everybody."""
    return {uid for _, uid in listening(port, kind)}


# ---- access control: what an older release's does not let through is dropped without a word on either side


def _access(robot: CheckedRobot) -> Seen | None:
    config = configuration(robot)[0]
    return None if config is None else passes(config, robot.settings.zenoh.config)


def passes(config: zenoh.Config, file: str) -> Seen | None:
    """What the access control of this Zenoh file drops of the others' messages; else, of a button's."""
    control, namespace = get(config, "access_control") or {}, get(config, "namespace")
    if not control.get("enabled") or control.get("default_permission") != "deny":
        return None
    dropped: dict[str, dict[str, None]] = {}
    for buttons in (False, True):  # a button may send little, and an operator's rules must let all of it through
        policies = (each["rules"] for each in control.get("policies") or [] if buttons <= (BUTTON in each["subjects"])
                    and (buttons or each["subjects"] != [BUTTON]))  # fmt: skip
        named = set(chain(*policies))
        rules = [each for each in control.get("rules") or [] if each["id"] in named]
        for traffic in (each for each in TRAFFIC if (BUTTON in each.roles if buttons else each.roles != (BUTTON,))):
            # Key by key: a file that was made by hand may name each.
            for key in (*COMMAND_KEYS, *GET_ONLY) if traffic.keys == (ALL_COMMANDS,) else traffic.keys:
                whole = f"{namespace}/{key}" if namespace else key
                lost = [each for each in traffic.messages if key not in GET_ONLY or each in _GET_ONLY_NEEDS]
                lost = [each for each in lost if not any(_lets(rule, traffic, each, whole) for rule in rules)]
                if lost:
                    dropped.setdefault(whole, {}).update(dict.fromkeys(lost))
        if dropped:
            break
    ports, keys = (re.search(r":(\d+)$", each) for each in listen_endpoints(config)), list(dropped)
    listener = next((int(found[1]) for found in ports if found), 7447)
    return Seen(
        file=file, dropped=dropped, buttons=buttons, messages=", ".join(dict.fromkeys(chain(*dropped.values()))),
        keys=", ".join(keys[:_SHOWN]) + (f" and {len(keys) - _SHOWN} more" if len(keys) > _SHOWN else ""),
        anew=f"{command_for_new_rules(file, listener, this_command())} && {RESTART}",
    )  # fmt: skip


def _lets(rule: dict[str, Any], traffic: Traffic, message: str, key: str) -> bool:
    flow = "ingress" if traffic.from_people else "egress"
    allows = rule["permission"] == "allow" and flow in (rule.get("flows") or (flow,)) and message in rule["messages"]
    return allows and any(zenoh.KeyExpr(each).includes(zenoh.KeyExpr(key)) for each in rule["key_exprs"])


# fmt: off
ZENOH: Final = Probe("Zenoh", _zenoh, (
    failure(lambda r: r.fault and r.denied, "{fault}", LET_READ),
    failure(lambda r: r.fault, "{fault}", "fix it there"),
    warning(lambda r: r.logged, "{logged}", "see docs/certificates.md for what each link needs"),
), "{well}")
ACCESS: Final = Probe("access control", _access, (
    warning(lambda r: r.dropped and not r.buttons, "{file} does not let {keys} through ({messages}): messages there "
            "are lost without a word", "make it anew: {anew}"),
    warning(lambda r: r.dropped, "{file} does not let {keys} through ({messages}): until it does, a stop button needs "
            "an operator's certificate", "make it anew: {anew}"),
), "lets all of this gateway's keys through")
PORTS: Final = Probe("port", _ports, (
    failure(lambda r: r.taken, "{where} is taken by another program",
            "see whose it is (ss -ltnp), or set another {setting}"),
    warning(lambda r: r.late, "{where} is not there yet ({why}): the service keeps trying, and listens on the others",
            "see the addresses of this machine (ip address), or set another {setting}"),
    failure(lambda r: r.why, "{where} cannot be listened on: {why}",
            "set another {setting}: an address of this machine (ip address), a port from 1024 to 65535"),
), "{where} {well}")
# fmt: on
