"""`python -m schemas [--check]`: write the JSON Schemas of all payloads, or list those that are out of date."""

import json
import sys
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from schemas.ack import Ack
from schemas.button import BUTTON_REQUEST, ButtonAck
from schemas.calibration import Calibration, CalibrationCommand
from schemas.command import SERVO_COMMAND, LegCommand, LegsCommand, ResetCommand
from schemas.config import ConfigReport
from schemas.event import Event, FrameRecord
from schemas.lease import LEASE_REQUEST, LeaseAck
from schemas.revocation import RevocationAck, RevocationRequest
from schemas.simulation import BodyReport
from schemas.state import StateReport
from schemas.telemetry import Telemetry

FOLDER = Path(__file__).with_name("json")


def documents() -> dict[str, str]:
    """Return the text of each payload's JSON Schema, by file name."""
    adapters: dict[str, TypeAdapter[Any]] = {
        "ServoCommand": SERVO_COMMAND,
        "LeaseRequest": LEASE_REQUEST,
        "ButtonRequest": BUTTON_REQUEST,
    }
    commands = (LegCommand, LegsCommand, ResetCommand, CalibrationCommand, RevocationRequest)
    answers = (Ack, LeaseAck, RevocationAck, ButtonAck)
    published = (StateReport, ConfigReport, Event, FrameRecord, Calibration, BodyReport, Telemetry)
    adapters |= {model.__name__: TypeAdapter(model) for model in (*commands, *answers, *published)}
    made = {name: adapter.json_schema(mode="validation") for name, adapter in adapters.items()}
    return {f"{name}.json": json.dumps(schema | {"title": name}, indent=2) + "\n" for name, schema in made.items()}


def main(arguments: list[str]) -> int:
    """Write the files; with `--check` only compare, and return 1 if one differs."""
    wanted = documents()
    present = {path.name: path.read_text() for path in FOLDER.glob("*.json")}
    if arguments == ["--check"]:
        for name in sorted(wanted.keys() | present.keys()):
            if wanted.get(name) != present.get(name):
                sys.stderr.write(f"schemas/json/{name} is out of date; run `python -m schemas`\n")
        return int(wanted != present)
    FOLDER.mkdir(exist_ok=True)
    for name in present.keys() - wanted.keys():
        (FOLDER / name).unlink()
    for name, text in wanted.items():
        (FOLDER / name).write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
