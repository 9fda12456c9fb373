"""Whether the Zenoh file's access control knows all that this gateway publishes and reads: an older release's may not.

What it does not know is dropped without a word on either side, so people see nothing but silence.
"""

import re
from collections.abc import Iterator
from typing import Any, Final

import zenoh

from gateway.certs import BUTTON
from gateway.certs.access import TRAFFIC, Traffic
from gateway.certs.zenoh_files import command_for_new_rules
from gateway.onboard.check.result import Result, ok, warning
from gateway.own_command import this_command
from gateway.zenoh_config import get, listen_endpoints
from schemas.keys import ALL_COMMANDS, COMMAND_KEYS, GET_ONLY, PUBLISHED, STATE

_NAME: Final = "access control"
_GET_ONLY_NEEDS: Final = frozenset({"query", "reply", "declare_queryable"})
_SHOWN: Final = 3


def passes(config: zenoh.Config, file: str) -> list[Result]:
    """What the access control of this Zenoh file does not let through; nothing where there is none."""
    if get(config, "access_control/enabled") is not True or get(config, "access_control/default_permission") != "deny":
        return []
    dropped = _dropped(config)
    buttons = _buttons(config, file, dropped)
    if not dropped:
        return [*([] if buttons else [ok(_NAME, "lets all of this gateway's keys through")]), *buttons]
    keys = list(dropped)
    more = f" and {len(keys) - _SHOWN} more" if len(keys) > _SHOWN else ""
    messages = list(dict.fromkeys(message for key in keys for message in dropped[key]))
    sentence = (
        f"{file} does not let {', '.join(keys[:_SHOWN])}{more} through ({', '.join(messages)}): messages there are "
        "lost without a word"
    )
    return [warning(_NAME, sentence, _fix(config, file, keys)), *buttons]


def _buttons(config: zenoh.Config, file: str, known: dict[str, list[str]]) -> list[Result]:
    """Whether a button's certificate reaches what it is for; a file of a release before there were any knows none."""
    dropped = {key: messages for key, messages in _dropped(config, BUTTON).items() if messages != known.get(key)}
    if not dropped:
        return []
    messages = dict.fromkeys(message for each in dropped.values() for message in each)
    sentence = (
        f"{file} does not let a certificate of the role button through ({', '.join(messages)}): until it does, a stop "
        "button needs an operator's"
    )
    return [warning("stop buttons", sentence, f"make it anew: {_anew(config, file)}")]


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


def _fix(config: zenoh.Config, file: str, keys: list[str]) -> str:
    namespace = get(config, "namespace")
    before = f"{namespace}/" if namespace else ""
    if {key.removeprefix(before) for key in keys} <= set(PUBLISHED):
        by_hand = ", ".join(f'"{key}"' for key in keys)
        anew = _anew(config, file)
        return f'in its rules, write {by_hand} next to each "{before}{STATE}", and restart; or make it anew: {anew}'
    return f"make it anew: {_anew(config, file)}"


def _anew(config: zenoh.Config, file: str) -> str:
    ports = (int(found[1]) for each in listen_endpoints(config) if (found := re.search(r":(\d+)$", each)))
    rules = command_for_new_rules(file, next(ports, 7447), this_command())
    return f"{rules} && sudo systemctl restart hexapod-gateway"
