"""Faults that no operator makes: another order of effects, another one of two things alike, another word in a text."""

from dataclasses import dataclass
from typing import Final

from tests.mutants.generated import Mutant, Name


@dataclass(frozen=True, slots=True)
class ByHand:
    """`old`, which stands exactly once in its file, becomes `new`; `why` is what somebody would suffer from that."""

    file: str
    old: str
    new: str
    why: str


MADE: Final[tuple[ByHand, ...]] = (
    ByHand(
        "gateway/certs/zenoh_files.py",
        "enable_mtls: true,\n        verify_name_on_connect: true,\n        close_link",
        "enable_mtls: false,\n        verify_name_on_connect: true,\n        close_link",
        "whoever reaches the robot commands it",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "verify_name_on_connect: true,\n        close_link",
        "verify_name_on_connect: false,\n        close_link",
        "the robot dials whoever answers",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "close_link_on_expiration: true",
        "close_link_on_expiration: false",
        "who is in stays in after its certificate",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "    enabled: true,\n    default_permission",
        "    enabled: false,\n    default_permission",
        "observers command",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        'default_permission: "deny"',
        'default_permission: "allow"',
        "observers command",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "rules: @OPERATORS_RULES@",
        "rules: @EVERYONES_RULES@",
        "operators watch only",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        'flows: ["ingress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"]',
        'flows: ["egress"], messages: ["put", "delete", "query", "reply"], key_exprs: ["**"]',
        "what comes in has no limit",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        'messages: ["put", "delete", "query", "reply"], key_exprs: ["**"]',
        'messages: ["put", "delete", "reply"], key_exprs: ["**"]',
        "a question has no limit",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "size_limit: @SIZE_LIMIT@",
        "size_limit: @MAX_MESSAGE_SIZE@",
        "four times as much reaches the gateway",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        'shared_memory: { enabled: false },\n    link: {\n      protocols: ["tls"],\n      // A link',
        'shared_memory: { enabled: true },\n    link: {\n      protocols: ["tls"],\n      // A link',
        "shared memory goes around the size limit",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        'protocols: ["tls"],\n      // A link',
        'protocols: ["tls", "tcp"],\n      // A link',
        "the robot dials without TLS",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "adminspace: { enabled: false }",
        "adminspace: { enabled: true }",
        "visitors read the configuration",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "tx: { lease: 1000 },\n      // No message",
        "tx: { lease: 10000 },\n      // No message",
        "a dead link holds what waits on it for 10 s",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "gossip: { enabled: false } },\n  adminspace",
        "gossip: { enabled: true } },\n  adminspace",
        "the robot is told of whoever is about",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "RULES=access.rules(namespace=namespace)",
        "RULES=access.rules()",
        "with a namespace, nobody can stop the robot",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "        NAMESPACE=_namespace(namespace),\n        RULES",
        '        NAMESPACE="",\n        RULES',
        "robots share their keys",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "ENDPOINTS=endpoints, NAMESPACE=_namespace(namespace))",
        'ENDPOINTS=endpoints, NAMESPACE="")',
        "a laptop commands all robots, or none",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "for host in hosts])\n",
        "for host in hosts[:1]])\n",
        "a second host is never tried",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "enable_mtls: true,\n        verify_name_on_connect: true,\n      },",
        "enable_mtls: true,\n        verify_name_on_connect: false,\n      },",
        "a laptop commands whoever poses as its robot",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        'mode: "client",@NAMESPACE@',
        'mode: "peer",@NAMESPACE@',
        "a laptop listens, too",
    ),
    ByHand(
        "gateway/certs/zenoh_files.py",
        "ip_address(host).version == 6 else host",
        "ip_address(host).version == 4 else host",
        "an IPv6 address cannot be dialled",
    ),
    ByHand(
        "gateway/robot/edge/inbox.py",
        'self._estop_replies = ReplySender("estop-answers")',
        "self._estop_replies = self._replies",
        "an emergency stop's answer waits behind an asker who does not read",
    ),
    ByHand(
        "gateway/robot/edge/inbox.py",
        "        self._estops.append(_received(self._estop_replies, ESTOP, item, received_ns))",
        "        self._estops.append(_received(item, ESTOP, received_ns, self._replies))",
        "an emergency stop's answer waits behind an asker who does not read",
    ),
    ByHand(
        "gateway/robot/edge/receiver.py",
        "                    with self._owner:\n                        pause_s = deal()\n",
        "                    pause_s = deal()\n",
        "two threads write frames at once",
    ),
    ByHand(
        "gateway/robot/host/ownership.py",
        "        with self._next:\n            self._state.acquire()\n",
        "        self._state.acquire()\n",
        "a thread that is flooded keeps the loop from the state, and systemd from hearing of it",
    ),
    ByHand(
        "gateway/robot/host/ownership.py",
        "        with self._next:\n            self._state.acquire()\n",
        "        self._next.acquire()\n        self._state.acquire()\n",
        "nobody owns the state a second time",
    ),
    ByHand(
        "gateway/robot/host/ownership.py",
        "                self._due_s = self._wakes_s = math.inf\n                self._callback()\n",
        "                self._callback()\n                self._due_s = self._wakes_s = math.inf\n",
        "what a timer's own call sets is forgotten",
    ),
    ByHand(
        "gateway/robot/edge/rings.py",
        "                        again |= ring.others\n",
        "                        again |= ring.before\n",
        "an older start overtakes a newer Stop of a wider key",
    ),
    ByHand(
        "gateway/robot/edge/rings.py",
        "            taken.sort(key=_place)\n",
        "            taken.sort(key=_place, reverse=True)\n",
        "several keys apply in the wrong order",
    ),
    ByHand(
        "gateway/robot/runtime/conductor.py",
        "            self._step(TimePassed(), instant_ns)\n",
        "            self._step(TimePassed())\n",
        "what a deadline stops is started by what the same tick had taken",
    ),
    ByHand(
        "gateway/robot/core/supervisor.py",
        "        self.legs.begin(now_ns if instant_ns is None else instant_ns)\n",
        "        self.legs.instant_ns = now_ns\n",
        "where time passes in an instant, a start overtakes a Stop, and a reset an emergency stop",
    ),
    ByHand(
        "gateway/robot/core/supervisor.py",
        "        self.estops += 1\n",
        "        self.estops += first\n",
        "a reset that was sent before the second emergency stop leaves it",
    ),
    ByHand(
        "gateway/robot/core/calibration.py",
        "        first, second, third = (self._wire_op(servo_id, op) for servo_id, op in frame.servos)\n",
        "        first, third, second = (self._wire_op(servo_id, op) for servo_id, op in frame.servos)\n",
        "two joints get each other's angles",
    ),
    ByHand(
        "gateway/robot/core/lease.py",
        "        self._give(to, None, now_ns, verified=self._askers[to])\n",
        "        self._give(to, self._token, now_ns, verified=self._askers[to])\n",
        "who has handed the robot over goes on driving it",
    ),
    ByHand(
        "gateway/robot/runtime/calibrations.py",
        "            self._keep(keep.calibration, kept)\n",
        "            self._keep(keep.calibration, kept)\n            kept(None)\n",
        "a calibration counts as kept before it is on the disk",
    ),
    ByHand(
        "gateway/robot/core/legs.py",
        "            effects += self._replaced(servo)\n            servo.note_stop(command",
        "            servo.note_stop(command",
        "an older start comes after the Stop",
    ),
    ByHand(
        "gateway/robot/core/legs.py",
        "            servo.note_stop(command.channel, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
        "            servo.note_stop(command.channel, now_ns)\n            self._stopped(servo, now_ns)\n",
        "an older start of the same instant overtakes the Stop, where time passes in it",
    ),
    ByHand(
        "gateway/robot/core/legs.py",
        "            if op.op is OP_STOP:\n                servo.note_stop(command.channel, self.instant_ns)\n",
        "            if op.op is OP_STOP:\n                servo.note_stop(command.channel, now_ns)\n",
        "an older start overtakes a Stop that came with moves, where time passes in an instant",
    ),
    ByHand(
        "gateway/robot/core/legs.py",
        "            servo.note_stop(cause, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
        "            servo.note_stop(cause, now_ns)\n            self._stopped(servo, now_ns)\n",
        "a start of the same instant undoes the watchdog's Stop, where time passes in it",
    ),
    ByHand(
        "gateway/robot/core/legs.py",
        "        for servo in self.servos.values():  # what is rejected here must not take effect on another leg\n",
        "        for servo in servos:  # what is rejected here must not take effect on another leg\n",
        "what was rejected for one leg still moves another",
    ),
    ByHand(
        "gateway/robot/core/legs.py",
        "            servo.repeats_left -= 1\n            servo.repeat_ns = now_ns + self._rules.repeat_interval_ns\n",
        "            servo.repeats_left -= 1\n            servo.repeat_ns += self._rules.repeat_interval_ns\n",
        "late repeats are made up in a burst",
    ),
    ByHand(
        "gateway/robot/core/pacing.py",
        "    return newer\n",
        "    return older\n",
        "the oldest target counts",
    ),
    ByHand(
        "gateway/robot/core/pacing.py",
        "self.legs.append(leg)",
        "self.legs.insert(0, leg)",
        "the last comes first: the others may wait for ever",
    ),
    ByHand(
        "gateway/robot/spi/bus.py",
        "        self._synchronised = self.resync_due = False\n        self._zeros = 0\n",
        "        self._synchronised = self.resync_due = False\n",
        "a device opened again gets no preamble",
    ),
)


def made_by_hand(file: str, source: str) -> list[Mutant]:
    """A file's. Raises ValueError where its text has changed since one was made."""
    mutants: list[Mutant] = []
    for each in MADE:
        if each.file == file:
            if source.count(each.old) != 1:
                raise ValueError(f"{file}: stands {source.count(each.old)} times in it, and must once: {each.old!r}")
            name = Name("by hand", each.why, " ".join(each.old.split()), " ".join(each.new.split()))
            mutants.append(Mutant(name, source.replace(each.old, each.new)))
    return mutants
