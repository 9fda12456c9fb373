"""The end of a gateway is kept first: only the newest part of the ring is read for it, and then the rest."""

from pathlib import Path

import pytest

from gateway.people.incidents import ring_reader, watcher
from gateway.people.incidents.watcher import IncidentWatcher
from gateway.people.recordings import read
from gateway.robot.blackbox import format as form
from gateway.robot.blackbox import place
from gateway.robot.blackbox.ring import Ring

S = 1_000_000_000
SLOTS = 256
WALL_NS = 1_790_000_000 * S
LATE_NS = 1000 * S


def ring(folder: Path, seconds: int, *incidents: tuple[int, str]) -> Path:
    """A gateway that was killed after so long; each second the clock and a lag, and these incidents."""
    made = Ring(folder / place.RING, SLOTS)
    made.append(form.START, 0, form.start(WALL_NS, {"pid": 1}))
    for second in range(1, seconds + 1):
        made.append(form.CLOCK, second * S, form.number(WALL_NS + second * S))
        made.append(form.LAG, second * S, form.number(second))
        for at_s, name in incidents:
            if at_s == second:
                made.append(form.INCIDENT, second * S, form.incident(WALL_NS + second * S, name))
    made.close()
    return folder / place.RING


def kept(folder: Path) -> dict[str, list[int]]:
    """The incidents by how their names end, and the times of what their files hold."""
    files = sorted((folder / place.INCIDENTS).glob("*.mcap"))
    return {path.stem.split("-", 3)[-1]: [message.time_ns for message in read(path)] for path in files}


@pytest.mark.parametrize("seconds", [5, 50, 300])
@pytest.mark.parametrize("most", [1, 7, SLOTS - 1, SLOTS, 1000])
def test_the_newest_slots_hold_the_newest_records(tmp_path: Path, seconds: int, most: int) -> None:
    path = ring(tmp_path, seconds)
    whole, newest = ring_reader.read(path), ring_reader.read(path, most)
    assert list(newest.records) == list(whole.records)[-most:]
    assert (newest.damaged, newest.missing) == (0, 0)


def test_a_torn_newest_record_hides_none_before_it(tmp_path: Path) -> None:
    path = ring(tmp_path, 100)
    last = ring_reader.read(path).records[-1].sequence
    data = bytearray(path.read_bytes())
    data[form.HEADER_BYTES + last % SLOTS * form.SLOT] ^= 1
    records, _, _ = ring_reader.parse(bytes(data), 3)
    assert [each.sequence for each in records] == [last - 3, last - 2, last - 1]


def test_the_end_is_kept_before_the_ring_is_read_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ring(tmp_path, 60, (20, "20260921-134700-000-estop"), (50, "20260921-134730-000-watchdog"))
    monkeypatch.setattr(watcher, "NEWEST", 30)
    IncidentWatcher(tmp_path, lambda: LATE_NS).keep(whole_only=False, most=watcher.NEWEST)
    first = kept(tmp_path)
    assert first.keys() == {"watchdog", "crash"}, "the emergency stop is further back"
    IncidentWatcher(tmp_path, lambda: LATE_NS).keep_all()
    second = kept(tmp_path)
    assert second.keys() == {"estop", "watchdog", "crash"}
    assert len(second["watchdog"]) > len(first["watchdog"]), "what it lacked is in it now"
    assert second["crash"] == first["crash"]
