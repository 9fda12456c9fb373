"""What goes out stays readable: the payloads of every earlier version, and those of later ones."""

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from schemas.button import ButtonAck
from schemas.calibration import Calibration
from schemas.lease import LeaseAck
from schemas.state import StateReport
from schemas.telemetry import Ack, ConfigReport, Event, FrameRecord, GatewayState

WIRE = Path(__file__).parents[1] / "data" / "wire"
MODELS: dict[str, type[BaseModel]] = {
    "ack": Ack,
    "state": StateReport,
    "config": ConfigReport,
    "event": Event,
    "frame": FrameRecord,
    "lease": LeaseAck,
    "calibration": Calibration,
    "button": ButtonAck,
}
BEFORE_CONFIG = "1.0"
"""Its states have the configuration inside, as recordings of rides do."""

RECORDED = [
    (
        f"{path.parent.name}/{path.name}:{number}",
        GatewayState if path.stem == "state" and path.parent.name == BEFORE_CONFIG else MODELS[path.stem],
        line,
    )
    for path in sorted(WIRE.glob("*/*.jsonl"))
    for number, line in enumerate(path.read_text().splitlines(), start=1)
]


def from_the_future(value: Any) -> Any:
    """Return the same with a new field in every object, and every word that a list of known ones has changed.

    Where an object's names are servos it stays as it is: there are no others.
    """
    if isinstance(value, list):
        return [from_the_future(inner) for inner in value]
    if not isinstance(value, dict):
        return value
    if value and all(name.isdecimal() for name in value):
        return {name: from_the_future(inner) for name, inner in value.items()}
    words = {name: f"new_{text}" for name, text in value.items() if name in _WORDS and isinstance(text, str)}
    return {name: from_the_future(inner) for name, inner in value.items()} | words | {"tomorrow": {"more": [1]}}


def contains(whole: Any, part: Any) -> bool:
    """Return whether everything in `part` stands in `whole` too."""
    if isinstance(part, dict):
        return all(name in whole and contains(whole[name], inner) for name, inner in part.items())
    if isinstance(part, list):
        return len(whole) == len(part) and all(map(contains, whole, part))
    return bool(whole == part)


_WORDS = ("kind", "mode", "reason", "cause", "watchdog")


def test_every_kind_of_payload_has_been_recorded() -> None:
    assert {path.parent.name for path in WIRE.glob("*/*.jsonl")} == {BEFORE_CONFIG, "1.1"}
    for version, missing in {BEFORE_CONFIG: {"config", "lease", "calibration", "button"}, "1.1": set[str]()}.items():
        assert {path.stem for path in (WIRE / version).glob("*.jsonl")} == MODELS.keys() - missing, version
    assert '"revocations":{"number":1' in (WIRE / "1.1/config.jsonl").read_text()


def test_what_earlier_versions_sent_is_read_whole() -> None:
    for place, model, line in RECORDED:
        read = model.model_validate_json(line)
        assert contains(json.loads(read.model_dump_json()), json.loads(line)), place


def test_what_later_versions_may_send_is_read_and_new_words_stay_text() -> None:
    for place, model, line in RECORDED:
        later = from_the_future(json.loads(line))
        read = json.loads(model.model_validate_json(json.dumps(later)).model_dump_json())
        for word in _WORDS:
            if isinstance(later.get(word), str):
                assert read[word] == later[word], place
