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
        Mutant("+ (intent.estop is not None)", "+ 1", "a reset may give a name twice"),
        Mutant("fields += intent.lease is not None", "fields += 1", "a name given twice passes where no lease is"),
        Mutant("without_secrets(json.dumps(value))", "json.dumps(value)", "an event shows a misplaced token"),
        Mutant('if where == "lease" and', 'if where == "leash" and', "an event shows most of a token"),
        Mutant("and not _SECRET.search(name)", "", "an event shows a token that stands where a name should"),
        Mutant(
            "if len(payload) > MAX_PAYLOAD_BYTES:", "if len(payload) >= MAX_PAYLOAD_BYTES:", "4096 bytes are rejected"
        ),
        Mutant("if len(payload) > MAX_PAYLOAD_BYTES:", "if False:", "anything is parsed, however long"),
        Mutant("if encoding not in ENCODINGS:", "if False:", "an image is parsed as JSON"),
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
