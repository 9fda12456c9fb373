"""Mutants of gateway/robot/core/intake.py: what a payload means, and why not."""

from tests.mutants.mutant import Mutant, Subject

INTAKE = Subject(
    "gateway/robot/core/intake.py",
    tests=(
        "tests/unit/robot/test_intake.py",
        "tests/unit/robot/test_conductor.py",
        "tests/unit/robot/test_conductor_safety.py",
    ),
    mutants=(
        Mutant('"application/json", "zenoh/bytes"}', '"application/json"}', "a plain put is rejected"),
        Mutant('"application/json", "zenoh/bytes"}', '"application/json", "zenoh/bytes", ""}', "no encoding is any"),
        Mutant(
            "bool(self.targets) and all(op.op is OP_STOP for _, op in self.targets)",
            "any(op.op is OP_STOP for _, op in self.targets)",
            "an old Start passes where a Stop stands beside it",
        ),
        Mutant(
            "bool(self.targets) and all(op.op is OP_STOP for _, op in self.targets)",
            "False",
            "a Stop that was delayed on its way is rejected",
        ),
        Mutant(
            "bool(self.targets) and all(op.op is OP_STOP for _, op in self.targets)",
            "all(op.op is OP_STOP for _, op in self.targets)",
            "a reset that was delayed on its way passes for a Stop",
        ),
        Mutant(
            "return Intent((), command.source, command.sent_ms, command.estop, command.lease)",
            "return Intent((), command.source, command.sent_ms)",
            "no reset says which emergency stop it leaves",
        ),
        Mutant(
            "return Intent((), command.source, command.sent_ms, command.estop, command.lease)",
            "return Intent((), command.source, None, command.estop, command.lease)",
            "a reset that was delayed on its way leaves the emergency stop",
        ),
        Mutant("+ (intent.estop is not None)", "+ 1", "a reset may give a name twice"),
        Mutant("fields += intent.lease is not None", "fields += 1", "a name given twice passes where no lease is"),
        Mutant("without_secrets(json.dumps(value))", "json.dumps(value)", "an event shows a misplaced token"),
        Mutant('if where == "lease" and', 'if where == "leash" and', "an event shows most of a token"),
        Mutant("and not _SECRET.search(name)", "", "an event shows a token that stands where a name should"),
        Mutant(
            "if key.target is _ESTOP:\n        return Intent()",
            "if key.target is _ESTOP and not payload:\n        return Intent()",
            "an emergency stop with a payload is none",
        ),
        Mutant(
            "if len(payload) > MAX_PAYLOAD_BYTES:", "if len(payload) >= MAX_PAYLOAD_BYTES:", "4096 bytes are rejected"
        ),
        Mutant("if len(payload) > MAX_PAYLOAD_BYTES:", "if False:", "anything is parsed, however long"),
        Mutant("if encoding not in ENCODINGS:", "if False:", "an image is parsed as JSON"),
        Mutant("if colons > _MAX_COLONS:", "if False:", "a payload of nothing but fields holds the loop"),
        Mutant("if colons > _MAX_COLONS:", "if colons >= _MAX_COLONS:", "the fullest legal command is rejected"),
        Mutant(
            "if colons > _fields(key.target, intent) else None",
            "if False else None",
            "two angles for one servo: the last counts, and nobody is told",
        ),
        Mutant(
            "if colons > _fields(key.target, intent) else None",
            "if colons > _fields(key.target, intent) + 1 else None",
            "one name may be given twice",
        ),
        Mutant(
            "if colons > _fields(key.target, intent) else None",
            "if colons >= _fields(key.target, intent) else None",
            "every payload is read twice",
            equivalent="only slower: what is good has no name twice, however often one looks",
        ),
        Mutant("return Intent(((key.number, STOP),))", "return Intent()", "a delete on a servo's key stops nothing"),
        Mutant(
            "tuple((servo_id, STOP) for servo_id in servo_ids_of(key.number))",
            "tuple((servo_id, STOP) for servo_id in servo_ids_of(key.number)[:2])",
            "a delete on a leg's key leaves joint 3 running",
        ),
        Mutant(
            "tuple((servo_id, STOP) for servo_id in SERVO_IDS)",
            "tuple((servo_id, STOP) for servo_id in SERVO_IDS[:-3])",
            "a delete of all legs leaves the sixth running",
        ),
        Mutant(
            'return Rejection(Reason.INVALID, "a delete does not reset; put {} on this key")',
            "return Intent()",
            "a wildcard delete leaves the emergency stop",
        ),
        Mutant(
            "Intent(_targets((servo_id,), (command,)), command.source, command.sent_ms, None, command.lease)",
            "Intent(_targets((servo_id,), (command,)), command.source)",
            "a delayed command for a servo is never noticed",
        ),
        Mutant(
            "Intent(_targets((servo_id,), (command,)), command.source, command.sent_ms, None, command.lease)",
            "Intent(_targets((servo_id,), (command,)), None, command.sent_ms)",
            "nobody knows who commanded",
        ),
        Mutant(
            "Intent(_targets(_IDS_OF_LEG[leg], command.servos), command.source, command.sent_ms, None, command.lease)",
            "Intent(_targets(_IDS_OF_LEG[leg], command.servos), command.source)",
            "a delayed command for a leg is never noticed",
        ),
        Mutant(
            "    return Intent(targets, command.source, command.sent_ms, None, command.lease)\n\n\ndef _read_reset",
            "    return Intent(targets, command.source)\n\n\ndef _read_reset",
            "a delayed command for several legs is never noticed",
        ),
        Mutant(
            "        if str(leg) in command.legs:\n",
            "        if str(leg) in command.legs and leg != LEGS[-1]:\n",
            "leg 6 is never commanded with others, nor stopped",
        ),
        Mutant(
            "ServoOp(_OPS[setpoint.op], round(setpoint.angle_deg * 100))",
            "ServoOp(OP_SET, round(setpoint.angle_deg * 100))",
            "a start is a set",
        ),
        Mutant(
            "ServoOp(_OPS[setpoint.op], round(setpoint.angle_deg * 100))",
            "ServoOp(OP_START, round(setpoint.angle_deg * 100))",
            "a set energises a servo that somebody stopped",
        ),
        Mutant(
            "round(setpoint.angle_deg * 100))",
            "int(setpoint.angle_deg * 100))",
            "angles are cut, not rounded",
        ),
        Mutant(
            '"start": OP_START, "set": OP_SET}', '"start": OP_SET, "set": OP_START}', "set energises, start does not"
        ),
        Mutant("(2 + 2 * len(JOINTS)) + 64\n", "(2 + 2 * len(JOINTS)) + 6\n", "a source with colons is rejected"),
        Mutant("4 + len(LEGS) * (2 +", "0 + len(LEGS) * (2 +", "the fullest legal command is rejected"),
        Mutant(
            """    try:
        from_json(payload)
    except ValueError as error:
        return _malformed(str(error))
""",
            "",
            "what is no JSON is told that it has too many fields",
        ),
        Mutant("fields += 1 if op is STOP else 2", "fields += 2", "a doubled name beside a Stop is not looked for"),
        Mutant(
            "    if target is _LEG:\n        fields += 1\n",
            "    if target is _LEG:\n        fields += 2\n",
            "a leg's servos may be given twice",
        ),
        Mutant(
            "1 + 2 * len(intent.targets) // len(JOINTS)",
            "2 + 2 * len(intent.targets) // len(JOINTS)",
            "one of several legs may be given twice",
        ),
        Mutant("= (intent.source is not None) + (", "= 1 + (", "a name given twice passes where no source is"),
        Mutant("+ (intent.sent_ms is not None)", "+ 1", "a name given twice passes where no sent_ms is"),
        Mutant("        if name in seen:\n", "        if False:\n", "names may be given twice"),
        Mutant("object_pairs_hook=_reject_doubles", "object_hook=lambda found: None", "names may be given twice"),
        Mutant(
            'if first["type"] == "json_invalid":',
            'if first["type"] == "never":',
            "what is no JSON is called invalid",
        ),
        Mutant("_MAX_ECHO: Final = 40", "_MAX_ECHO: Final = 4000", "an answer repeats what a stranger sent, at length"),
        Mutant("_MAX_ECHO_BITS: Final = 128", "_MAX_ECHO_BITS: Final = 1280000", "thousands of digits hold the loop"),
        Mutant("_PLAIN_NAME.fullmatch(name)", "_PLAIN_NAME.match(name)", "a terminal's escapes reach the log"),
        Mutant(
            'r"[\\w./-]{1,40}", re.ASCII', 'r"[\\w./-]{1,40}"', "letters that look like others are shown as they are"
        ),
        Mutant("json.dumps(value))\n", "str(value))\n", "line breaks and escapes reach the log"),
        Mutant("len(faults) > 1 else", "len(faults) > 2 else", "of two faults the sender hears of one"),
        Mutant(
            "(and {len(faults) - 1} more)", "(and {len(faults)} more)", "the sender looks for a fault that is not there"
        ),
        Mutant(
            "fault['ctx']['actual_length']",
            "fault['ctx']['max_length']",
            "four servos are called three",
        ),
        Mutant('path += f"[{part}]"', 'path += f"[{part + 1}]"', "the sender looks at the wrong servo"),
    ),
)
