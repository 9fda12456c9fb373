"""What `check` says of an access control that an earlier release made, which drops what this one says."""

import re
from pathlib import Path

import zenoh

from gateway.certs.zenoh_files import gateway_json5
from gateway.onboard.check.access import passes
from gateway.onboard.check.result import Result, Verdict
from schemas.keys import CALIBRATION, COMMAND_KEYS, ESTOP, GET_ONLY, STATE


def checked(text: str | bytes, folder: Path) -> list[Result]:
    file = folder / "gateway.json5"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return passes(zenoh.Config.from_file(str(file)), "gateway.json5")


def made() -> str:
    return gateway_json5(["robot.local"], 7448).decode()


def without(text: str, key: str) -> str:
    older, count = re.subn(rf',\s*"{key}"', "", text)
    assert count == 4
    return older


def test_what_this_release_makes_passes(tmp_path: Path) -> None:
    (result,) = checked(made(), tmp_path)
    assert result.verdict is Verdict.OK


def test_a_key_that_came_later_is_named_with_what_fixes_it(tmp_path: Path) -> None:
    (result,) = checked(without(made(), CALIBRATION), tmp_path)
    assert result.verdict is Verdict.WARNING
    assert f"does not let {CALIBRATION} through" in result.sentence
    for message in ("declare_subscriber", "put", "query", "reply", "declare_queryable"):
        assert message in result.sentence
    assert f'write "{CALIBRATION}" next to each "{STATE}"' in result.fix
    assert "--port 7448" in result.fix


def test_the_line_that_it_names_fixes_it(tmp_path: Path) -> None:
    older = without(made(), CALIBRATION)
    (result,) = checked(older.replace(f'"{STATE}"', f'"{STATE}", "{CALIBRATION}"'), tmp_path)
    assert result.verdict is Verdict.OK


def test_a_rule_that_no_policy_names_lets_nothing_through(tmp_path: Path) -> None:
    (result,) = checked(made().replace('["commands",', "["), tmp_path)
    more = len(COMMAND_KEYS) + len(GET_ONLY) - 3
    assert f"hexapod/legs/cmd, hexapod/leg/1/cmd, hexapod/leg/2/cmd and {more} more" in result.sentence
    assert "(put, delete, query)" in result.sentence
    assert result.fix.startswith("make it anew: d=$(mktemp -d) && ")


def test_a_message_or_a_direction_that_a_rule_lacks_is_named(tmp_path: Path) -> None:
    no_delete = made().replace('messages: ["put", "delete", "query"],\n        key_exprs: ["hexapod/**/cmd"]', (
        'messages: ["put", "query"],\n        key_exprs: ["hexapod/**/cmd"]'
    ))  # fmt: skip
    (result,) = checked(no_delete, tmp_path)
    assert "26 more" not in result.sentence
    assert "(delete)" in result.sentence
    (result,) = checked(re.sub(r'("telemetry".*?)egress', r"\1ingress", made(), flags=re.DOTALL), tmp_path)
    assert "does not let hexapod/state, hexapod/event, hexapod/frame and 3 more through (put)" in result.sentence


def test_one_that_was_made_by_hand_key_by_key_passes_but_for_what_it_lacks(tmp_path: Path) -> None:
    keys = [f'"hexapod/{key}/cmd"' for key in ("leg/*", "servo/*", "legs", "reset")]
    keys += [f'"{key}"' for key in GET_ONLY]
    (result,) = checked(made().replace('"hexapod/**/cmd"', ", ".join(keys)), tmp_path)
    assert f"does not let {ESTOP} through (put, delete, query, reply, declare_subscriber, " in result.sentence


def test_a_rule_that_buttons_lack_is_named(tmp_path: Path) -> None:
    (found,) = checked(re.sub(r'"presses and check-ins",(?! permission)', "", made()), tmp_path)
    assert (found.verdict, found.name) == (Verdict.WARNING, "stop buttons")
    assert "(query)" in found.sentence


def test_without_access_control_there_is_nothing_to_say(tmp_path: Path) -> None:
    assert checked("{}", tmp_path) == []
    off = made().replace("access_control: {\n    enabled: true", "access_control: {\n    enabled: false")
    assert checked(off, tmp_path) == []
