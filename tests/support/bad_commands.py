"""JSON that is no command: the payload (text, or a value to be sent as JSON), and the sentence that answers it."""

import json
from typing import Any

from schemas.command import MAX_NUMBER, MAX_SENT_MS
from schemas.keys import CommandKey
from tests.support.commands import LEG, LEG_3, LEGS_KEY, RESET_KEY, SERVO_32, STOP

OP_RULE = 'it must be "start", "set" or "stop"'
LEASE_RULE = "lease must be 32 hex digits, a to f in lower case"
GIVEN_TWICE = "is given twice in one object; give it once"


def leg_with(third: object) -> dict[str, Any]:
    return {"servos": [STOP, STOP, third]}


ANGLE = '{"op": "start", "angle_deg": %s}'
SERVO_FAULTS: list[tuple[object, str]] = [
    # the payload as a whole
    ([], "the payload is []; it must be an object"),
    ('"stop"', 'the payload is "stop"; it must be an object'),
    ([STOP], 'the payload is [{"op": "stop"}]; it must be an object'),
    ({"command": STOP}, f"op is missing; {OP_RULE}"),
    # op
    ({}, f"op is missing; {OP_RULE}"),
    ({"op": "STOP"}, f'op is "STOP"; {OP_RULE}'),
    ({"op": 1}, f"op is 1; {OP_RULE}"),
    ({"op": ["stop"]}, f'op is ["stop"]; {OP_RULE}'),
    ({"op": "\n\x1b[31m"}, rf'op is "\n\u001b[31m"; {OP_RULE}'),
    ({"op": "z" * 38}, f'op is "{"z" * 38}"; {OP_RULE}'),
    ({"op": "z" * 4000}, f'op is "{"z" * 39}…; {OP_RULE}'),
    # angle_deg
    ({"op": "start"}, "angle_deg is missing"),
    ({"op": "start", "angle": 90}, "angle_deg is missing (and 1 more)"),
    (ANGLE % "null", "angle_deg is null; it must be a number"),
    (ANGLE % '"90"', 'angle_deg is "90"; it must be a number'),
    (ANGLE % "true", "angle_deg is true; it must be a number"),
    (ANGLE % "NaN", "angle_deg is NaN; it must be a finite number"),
    (ANGLE % "Infinity", "angle_deg is Infinity; it must be a finite number"),
    (ANGLE % "1e999", "angle_deg is Infinity; it must be a finite number"),
    (ANGLE % ("9" * 4000), "angle_deg is a whole number of about 4000 digits; it must be a finite number"),
    (ANGLE % 2**128, "angle_deg is a whole number of about 39 digits; it must be between 0 and 180"),
    (ANGLE % (2**128 - 1), "angle_deg is (hex digits); it must be between 0 and 180"),
    (ANGLE % ("9" * 30), f"angle_deg is {'9' * 30}; it must be between 0 and 180"),
    (ANGLE % "180.001", "angle_deg is 180.001; it must be between 0 and 180"),
    (ANGLE % "-1e-300", "angle_deg is -1e-300; it must be between 0 and 180"),
    # what a stop has, and has not
    ({"op": "stop", "angle_deg": 0}, "angle_deg is not known here; stop takes no angle"),
    # unknown names, also such as pydantic uses itself
    ({"op": "stop", "Op": "start"}, "Op is not known here"),
    ({"op": "stop", "stop": 1}, "stop is not known here"),
    ({"op": "stop", "[key]": 1}, '"[key]" is not known here'),
    ({"op": "stop", "": 1}, '"" is not known here'),
    ({"op": "stop", "a\nb\u2028": 1}, r'"a\nb\u2028" is not known here'),
    ({"op": "stop", "grüße": 1}, r'"gr\u00fc\u00dfe" is not known here'),
    ({"op": "stop", "k" * 4000: 1}, f'"{"k" * 39}… is not known here'),
    ({"op": "stop"} | {str(n): n for n in range(50)}, "0 is not known here (and 49 more)"),
    ({"op": "stop"} | {str(n): n for n in range(300)}, "the payload has more fields than any command of its key has"),
    ('{"op": "stop", "x": ' + "[" * 150 + "]" * 150 + "}", "x is not known here"),
    # who, and when
    (STOP | {"source": ""}, "source must have 1 to 64 characters"),
    (STOP | {"source": "x" * 65}, "source must have 1 to 64 characters"),
    (STOP | {"source": 1}, "source is 1; it must be a string"),
    (STOP | {"sent_ms": "1"}, 'sent_ms is "1"; it must be a number'),
    (STOP | {"sent_ms": -1}, f"sent_ms is -1; it must be between 0 and {MAX_SENT_MS}"),
    (STOP | {"sent_ms": 1e300}, f"sent_ms is 1e+300; it must be between 0 and {MAX_SENT_MS}"),
    # the same name twice
    ('{"op": "start", "op": "stop"}', f"op {GIVEN_TWICE}"),
    ('{"op": "set", "angle_deg": 1, "angle_deg": 2}', f"angle_deg {GIVEN_TWICE}"),
    ('{"op": "set", "angle_deg": 1, "angle\\u005fdeg": 2}', f"angle_deg {GIVEN_TWICE}"),
]
LEG_FAULTS: list[tuple[object, str]] = [
    ({}, "servos is missing"),
    ({"servos": None}, "servos is null; it must be an array"),
    ({"servos": {"1": STOP}}, 'servos is {"1": {"op": "stop"}}; it must be an array'),
    ({"servos": []}, "servos[0] is missing; a leg has 3 servos (and 2 more)"),
    ({"servos": [STOP, STOP]}, "servos[2] is missing; a leg has 3 servos"),
    ({"servos": [STOP] * 4}, "servos has 4 entries; a leg has 3 servos"),
    (leg_with(None), "servos[2] is null; it must be an object"),
    (leg_with({}), f"servos[2].op is missing; {OP_RULE}"),
    (leg_with({"op": "go"}), f'servos[2].op is "go"; {OP_RULE}'),
    (leg_with({"op": "set"}), "servos[2].angle_deg is missing"),
    (leg_with({"op": "set", "angle_deg": 190.0}), "servos[2].angle_deg is 190.0; it must be between 0 and 180"),
    (leg_with(STOP | {"angle_deg": 1}), "servos[2].angle_deg is not known here; stop takes no angle"),
    (leg_with(STOP | {"start": 1}), "servos[2].start is not known here"),
    (LEG | {"angle_deg": 1}, "angle_deg is not known here"),
    (LEG | {"stop": 1}, "stop is not known here"),
    (STOP, "servos is missing (and 1 more)"),
    ('{"servos": [{"op": "stop", "op": "stop"}, {"op": "stop"}, {"op": "stop"}]}', f"op {GIVEN_TWICE}"),
]
LEGS_FAULTS: list[tuple[object, str]] = [
    ({}, "legs is missing"),
    ({"legs": {}}, "legs is empty; name at least one leg"),
    ({"legs": [LEG]}, 'legs is [{"servos": [{"op": "start", "angle_deg"…; it must be an object'),
    ({"legs": {"7": LEG}}, 'legs has "7"; it may have "1" to "6"'),
    ({"legs": {"01": LEG}}, 'legs has "01"; it may have "1" to "6"'),
    ({"legs": {"q" * 3000: LEG}}, f'legs has "{"q" * 39}…; it may have "1" to "6"'),
    ({"legs": {"1": LEG, "x\n": LEG}}, r'legs has "x\n"; it may have "1" to "6"'),
    ({"legs": {"1": {}}}, "legs.1.servos is missing"),
    ({"legs": {"1": LEG, "4": leg_with(7)}}, "legs.4.servos[2] is 7; it must be an object"),
    (
        {"legs": {"4": leg_with({"op": "set", "angle_deg": -1})}},
        "legs.4.servos[2].angle_deg is -1; it must be between 0 and 180",
    ),
    ({"legs": {"4": LEG | {"source": "x"}}}, "legs.4.source is not known here"),
    ({"legs": {str(n): 1 for n in range(10, 90)}}, 'legs has "10"; it may have "1" to "6" (and 159 more)'),
    ({"legs": {str(n): 1 for n in range(10, 400)}}, "the payload has more fields than any command of its key has"),
    (f'{{"legs": {{}}, "legs": {{"1": {json.dumps(LEG)}}}}}', f"legs {GIVEN_TWICE}"),
    (f'{{"legs": {{"1": {json.dumps(LEG)}, "1": {json.dumps(leg_with(STOP))}}}}}', f"1 {GIVEN_TWICE}"),
]
RESET_FAULTS: list[tuple[object, str]] = [
    ("[]", "the payload is []; it must be an object"),
    ({"force": True}, "force is not known here"),
    ({"estop": -1}, f"estop is -1; it must be between 0 and {MAX_NUMBER}"),
    ({"estop": 10**20}, f"estop is {10**20}; it must be between 0 and {MAX_NUMBER}"),
    ({"estop": "1"}, 'estop is "1"; it must be a whole number'),
    ('{"estop": 1.5}', "estop is 1.5; it must be a whole number"),
    ('{"estop": 1e999}', "estop is Infinity; it must be a whole number"),
    ({"estop": 1, "lease": "0" * 31}, LEASE_RULE),
    ({"estop": 1, "lease": "F" * 32}, LEASE_RULE),
    ({"estop": 1, "lease": "0" * 31 + "\n"}, LEASE_RULE),
    ({"estop": 1, "lease": 7}, LEASE_RULE),
    ({"lesae": "ab" * 16}, "lesae is not known here"),
    ({"ab" * 16: 1}, '"(hex digits)" is not known here'),
    ([{"lease": "ab" * 16}], 'the payload is [{"lease": "(hex digits)"}]; it must be an object'),
    ({"estop": "ab" * 16}, 'estop is "(hex digits)"; it must be a whole number'),
    (f'{{"lease": "{"ab" * 16}", "lease": "{"cd" * 16}"}}', f"lease {GIVEN_TWICE}"),
    ('{"estop": 1, "estop": 2}', f"estop {GIVEN_TWICE}"),
]
FAULTS: list[tuple[CommandKey, object, str]] = [
    (key, *fault)
    for key, faults in (
        (SERVO_32, SERVO_FAULTS), (LEG_3, LEG_FAULTS), (LEGS_KEY, LEGS_FAULTS), (RESET_KEY, RESET_FAULTS)
    )
    for fault in faults
]  # fmt: skip
