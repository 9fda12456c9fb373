"""Faults that no operator makes: another order of effects, another one of two things alike, another word in a text."""

from collections.abc import Mapping
from typing import Final, NamedTuple

from tests.mutants.generated import Mutant


class ByHand(NamedTuple):
    """`old`, which stands exactly once in its file, becomes `new`; `why` is what somebody would suffer from that."""

    why: str
    old: str
    new: str


MADE: Final[Mapping[str, tuple[ByHand, ...]]] = {
    "gateway/certs/access.py": (
        ByHand("operators watch only", "if each.roles == roles]", "if each.roles == LAPTOP_ROLES]"),
        ByHand("observers command", 'default_permission: "deny"', 'default_permission: "allow"'),
        ByHand("what comes in has no limit", 'flows: ["ingress"]', 'flows: ["egress"]'),
        ByHand("a question has no limit", '"delete", "query", "reply"]', '"delete", "reply"]'),
        ByHand("four times as much reaches the gateway", "size_limit: @SIZE_LIMIT@", "size_limit: @MAX_MESSAGE_SIZE@"),
        ByHand("the robot dials without TLS", '["tls"],\n      // A link', '["tls", "tcp"],\n      // A link'),
        ByHand("a dead link holds what waits on it for 10 s", "1000 },\n      // Limit", "10000 },\n      // Limit"),
        ByHand("a second host is never tried", "json.dumps(endpoints))", "json.dumps(endpoints[:1]))"),
        ByHand("a laptop listens, too", 'mode: "client",', 'mode: "peer",'),
    ),
    "gateway/robot/zenoh_io/inbox.py": (
        ByHand(
            "an emergency stop's answer waits behind an asker who does not read",
            'self._estop_replies = Worker("estop-answers", priority=None)',
            "self._estop_replies = self._replies",
        ),
        ByHand(
            "an emergency stop's answer waits behind an asker who does not read",
            "        self.estops.append(_received(self._estop_replies, ESTOP, item, received_ns))",
            "        self.estops.append(_received(self._replies, ESTOP, item, received_ns))",
        ),
    ),
    "gateway/robot/zenoh_io/receiver.py": (
        ByHand(
            "two threads write frames at once",
            "with self._owner:\n                        pause_s",
            "if True:\n                        pause_s",
        ),
    ),
    "gateway/robot/host/ownership.py": (
        ByHand(
            "a thread that is flooded keeps the loop from the state, and systemd from hearing of it",
            "        with self._next:\n            self._state.acquire()\n",
            "        self._state.acquire()\n",
        ),
        ByHand(
            "nobody owns the state a second time",
            "        with self._next:\n            self._state.acquire()\n",
            "        self._next.acquire()\n        self._state.acquire()\n",
        ),
        ByHand(
            "what a timer's own call sets is forgotten",
            "                self._due_s = self._wakes_s = math.inf\n                self._callback()\n",
            "                self._callback()\n                self._due_s = self._wakes_s = math.inf\n",
        ),
    ),
    "gateway/robot/zenoh_io/rings.py": (
        ByHand("an older start overtakes a newer Stop of a wider key", "True, ring.others", "True, ring.before"),
        ByHand("several keys apply in the wrong order", "each: each[0].place", "each: -each[0].place"),
    ),
    "gateway/robot/runtime/conductor.py": (
        ByHand(
            "what a deadline stops is started by what the same tick had taken",
            "            self._step(TimePassed(), instant_ns)\n",
            "            self._step(TimePassed())\n",
        ),
    ),
    "gateway/robot/core/supervisor.py": (
        ByHand(
            "where time passes in an instant, a start overtakes a Stop, and a reset an emergency stop",
            "        legs.begin(now_ns if instant_ns is None else instant_ns)\n",
            "        legs.begin(now_ns)\n",
        ),
    ),
    "gateway/robot/core/latch.py": (
        ByHand("a reset sent before the second emergency stop leaves it", "self.number += 1", "self.number += first"),
    ),
    "gateway/model/calibration.py": (
        ByHand("a leg's joints get the first one's calibration", "cdeg_of(each,", "cdeg_of(frame.servos[0][0],"),
    ),
    "gateway/robot/core/lease.py": (
        ByHand("who has handed the robot over goes on driving it", "_give(to, None,", "_give(to, self._token,"),
    ),
    "gateway/robot/runtime/calibrations.py": (
        ByHand(
            "a calibration counts as kept before it is on the disk",
            "self._disk.write(keep_file, kept)\n",
            "self._disk.write(keep_file, kept)\n        kept(None)\n",
        ),
    ),
    "gateway/robot/core/legs.py": (
        ByHand(
            "an older start of the same instant overtakes the Stop, where time passes in it",
            "servo.stop(command.channel, self.instant_ns, ",
            "servo.stop(command.channel, now_ns, ",
        ),
        ByHand(
            "a start of the same instant undoes the watchdog's Stop, where time passes in it",
            "servo.stop(cause, self.instant_ns, ",
            "servo.stop(cause, now_ns, ",
        ),
        ByHand("what was rejected for one leg still moves another", "in self.servos.values():  #", "in servos:  #"),
        ByHand(
            "a servo goes on to where a rejected command has sent it",
            "            if servo.target is not None and servo.command in rejected:",
            "            if servo.pending and servo.command in rejected:",
        ),
    ),
    "gateway/robot/core/servo.py": (
        ByHand("the oldest angle of a start counts", "STARTS[op.angle_cdeg] if", "self.target if"),
    ),
    "gateway/robot/core/stops.py": (
        ByHand(
            "late repeats are made up in a burst",
            "            repeats.due_ns = now_ns + self._rules.repeat_interval_ns\n        self.sent",
            "            repeats.due_ns += self._rules.repeat_interval_ns\n        self.sent",
        ),
        ByHand(
            "a Stop moves a repeat that is owed to a later time",
            "            if not repeats.left:\n",
            "            if True:\n",
        ),
        ByHand("a Stop at rest moves the runs that are owed", "elif self._round_ns is None:\n", "else:\n"),
        ByHand(
            "no runs follow the last Stop",
            "self._runs_left, self._settled_ns = self.runs, ",
            "self._runs_left, self._settled_ns = 0, ",
        ),
    ),
    "gateway/robot/core/backlog.py": (
        ByHand("a clump adds nothing", "min(rules.most_clumped, stretch.score + CLUMPED)", "stretch.score"),
        ByHand("a key never begins anew", "now_ns - stretch.last_ns >= rules.quiet_ns:", "False:"),
        ByHand("an answered get is taken for a clump", "1 if command.verb is _GET else rules", "rules"),
        ByHand("only the servo's own key counts", "servo.servo_id in each.servos", "len(each.servos) == 1"),
    ),
}


def made_by_hand(file: str, source: str) -> list[Mutant]:
    """Return a file's mutants. Raises ValueError where its text has changed since one was made."""
    mutants: list[Mutant] = []
    for why, old, new in MADE.get(file, ()):
        if source.count(old) != 1:
            raise ValueError(f"{file}: stands {source.count(old)} times in it, and must once: {old!r}")
        line = source[: source.index(old)].count("\n") + 1
        mutants.append(Mutant(line, "by hand", why, " ".join(new.split()), source.replace(old, new)))
    return mutants
