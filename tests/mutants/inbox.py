"""Mutants of gateway/robot/edge/inbox.py, rings.py and core/message.py: what comes in, and in which order."""

from tests.mutants.mutant import Mutant, Subject

_TESTS = (
    "tests/zenoh/test_rings.py",
    "tests/zenoh/test_inbox_parts.py",
    "tests/zenoh/test_inbox_wakeups.py",
    "tests/unit/robot/test_ownership.py",
)

MESSAGE = Subject(
    "gateway/robot/core/message.py",
    tests=_TESTS,
    mutants=(
        Mutant(
            """return f"{'get' if self.verb is _GET else 'put'} {self.key}\"""",
            "return self.key",
            "a put and a get of one key count as in order: a start overtakes a Stop",
        ),
        Mutant(
            """return f"{'get' if self.verb is _GET else 'put'} {self.key}\"""",
            """return f"{self.verb} {self.key}\"""",
            "a delete and a put of one key count as of two: a start after it is rejected",
        ),
        Mutant(
            """return f"{'get' if self.verb is _GET else 'put'} {self.key}\"""",
            """return f"{'get' if self.verb is _GET else 'put'}\"""",
            "all keys count as in order: a start overtakes a Stop",
        ),
    ),
)

INBOX = Subject(
    "gateway/robot/edge/inbox.py",
    tests=_TESTS,
    mutants=(
        Mutant("OTHER_DEPTH: Final = 16", "OTHER_DEPTH: Final = 1", "of two unknown keys one is never answered"),
        Mutant(
            "FLOOD_PAUSE_S: Final = 0.001",
            "FLOOD_PAUSE_S: Final = 0.1",
            "a flood of one key holds all others for 100 ms",
        ),
        Mutant(
            'self._estop_replies = ReplySender("estop-answers")',
            "self._estop_replies = self._replies",
            "an emergency stop's answer waits behind an asker who does not read",
        ),
        Mutant(
            "self._subscriber(session, key, depth).try_recv",
            "self._subscriber(session, key, 1).try_recv",
            "a start and the set behind it: only one is taken",
        ),
        Mutant(
            "self._queryable(session, key, RING_DEPTH).try_recv",
            "self._queryable(session, key, 1).try_recv",
            "of two questions one is never answered",
        ),
        Mutant(
            '("estop-get", self._queryable(session, ESTOP, RING_DEPTH))',
            '("estop-get", self._queryable(session, ESTOP, 1))',
            "of two emergency stops one is never answered",
        ),
        Mutant(
            "self._queryable(session, STATE, RING_DEPTH),",
            "self._queryable(session, STATE, 1),",
            "of two who ask for the state one waits in vain",
        ),
        Mutant(
            "        self._threads += [self._replies.thread, self._estop_replies.thread]\n",
            "",
            "with a dead reply sender the service says that it hears",
        ),
        Mutant(
            "            received = _lost(key, self._passed_over) if each is None else each\n            while self._estops:\n                yield self._estops.popleft()\n",
            "            received = _lost(key, self._passed_over) if each is None else each\n",
            "an emergency stop waits for all that was taken before",
        ),
        Mutant(
            "            yield received\n        while self._estops:\n            yield self._estops.popleft()\n",
            "            yield received\n",
            "an emergency stop without other traffic is never taken",
        ),
        Mutant(
            "return all(thread.is_alive() for thread in self._threads)",
            "return any(thread.is_alive() for thread in self._threads)",
            "with a dead receiver the service says that it hears",
        ),
        Mutant(
            "        for answers in (self._replies, self._estop_replies):\n            answers.close()\n",
            "",
            "reply senders outlive the inbox",
        ),
        Mutant(
            "        self._estops.append(_received(self._estop_replies, ESTOP, item, received_ns))",
            "        self._estops.append(_received(item, ESTOP, received_ns, self._replies))",
            "an emergency stop's answer waits behind an asker who does not read",
        ),
        Mutant(
            "        return self._engage_all\n",
            "        return lambda: None\n",
            "an emergency stop waits for the next command",
        ),
        Mutant(
            "    def _engage_all(self) -> None:\n        while self._estops:\n",
            "    def _engage_all(self) -> None:\n        if True:\n",
            "an emergency stop that a tick has served already ends the service",
        ),
        Mutant(
            "                    self._note(item, received_ns)\n                    count",
            "                    count",
            "of several messages at once, only the first is taken in time",
        ),
        Mutant(
            "self._read_all = self._read_all or count >= OTHER_DEPTH - 2",
            "pass",
            "a message whose wakeup was lost is never taken",
        ),
        Mutant(
            "self._read_all = self._read_all or count >= OTHER_DEPTH - 2",
            "self._read_all = True",
            "each message looks into all rings, and waits a millisecond",
        ),
        Mutant(
            "        return FLOOD_PAUSE_S if flooded else None\n",
            "        return None\n",
            "in a flood, ticks take the processor from what receives",
        ),
        Mutant(
            "_named(item, COMMAND_KEYS) if wild else",
            "_named(item, COMMAND_KEYS) if False else",
            "a wildcard stops nothing",
        ),
        Mutant(
            " and not (wild and isinstance(item, zenoh.Query) and _named(item, self._read_elsewhere)):",
            ":",
            "who asks for calibration and lease by wildcard gets two answers, of which one is wrong",
        ),
        Mutant(
            "            if not named and not (wild",
            "            if False and not (wild",
            "an unknown key is never answered",
        ),
        Mutant(
            "            (self._estop_replies if key == ESTOP else self._replies).let_go(item)\n",
            "            pass\n",
            "the loop ends queries, and waits for askers who do not read",
        ),
        Mutant(
            "(self._estop_replies if key == ESTOP else self._replies).let_go(item)",
            "self._replies.let_go(item)",
            "an emergency stop's answer waits behind an asker who does not read",
        ),
        Mutant(
            "            found += [(other.key, other) for other in self._others]\n            self._others.clear()\n",
            "            self._others.clear()\n",
            "an unknown key is never answered",
        ),
        Mutant(
            "            found += [(other.key, other) for other in self._others]\n            self._others.clear()\n",
            "            found += [(other.key, other) for other in self._others]\n",
            "an unknown key is answered again and again",
        ),
        Mutant("_DELETE if item.kind == _KIND_DELETE else _PUT", "_PUT", "a delete stops nothing"),
        Mutant(
            'if payload is not None and size <= MAX_PAYLOAD_BYTES else b""',
            'if payload is not None and size < MAX_PAYLOAD_BYTES else b""',
            "a payload of just 4096 bytes is read as empty",
        ),
        Mutant(
            'if payload is not None and size <= MAX_PAYLOAD_BYTES else b""',
            'if payload is not None else b""',
            "16 kB are copied from each message of a flood",
        ),
        Mutant(
            'if item.encoding is not None else "zenoh/bytes"',
            'if False else "zenoh/bytes"',
            "an image is parsed as JSON",
        ),
        Mutant("if item.source_info is not None else None", "if False else None", "nobody knows who commanded"),
        Mutant(
            '    if received.verb is _DELETE:\n        return b""\n',
            "",
            "a delete in a flood does not keep the instant open: an older start follows it",
        ),
        Mutant(
            'return words if b"stop" in words or b"\\\\" in words else None',
            'return words if b"stop" in words else None',
            "a Stop written with escapes does not keep the instant open",
        ),
        Mutant(
            'return words if b"stop" in words or b"\\\\" in words else None',
            "return None",
            "in a flood an older start follows a Stop",
        ),
        Mutant(
            "            if missed_more:\n                self._look(0)\n",
            "            pass\n",
            "a message that reaches its ring after its wakeup waits for the next one",
        ),
        Mutant(
            "        if attempt + 1 < len(LOOK_AGAIN_S):\n            self._look(attempt + 1)\n        else:\n",
            "        if attempt + 1 < len(LOOK_AGAIN_S):\n            self._look(attempt)\n        else:\n",
            "the loop looks again for ever",
        ),
        Mutant(
            "        self._wake()\n        self._look_at = ()\n",
            "        self._look_at = ()\n",
            "a message that reaches its ring after its wakeup waits for the next one",
        ),
        Mutant(
            "            self._closing.set(self._loop.time() + FLOOD_PAUSE_S)  # to close it",
            "            pass  # to close it",
            "after a flood, an instant stays open: a start is rejected",
        ),
    ),
)

RINGS = Subject(
    "gateway/robot/edge/rings.py",
    tests=_TESTS,
    mutants=(
        Mutant("RING_DEPTH: Final = 8", "RING_DEPTH: Final = 1", "a start and the set behind it: only one is taken"),
        Mutant("        if len(found) == ring.depth:\n", "        if False:\n", "a Stop in a flood of its key is lost"),
        Mutant(
            "            return [None, *newest]\n",
            "            return newest\n",
            "a Stop in a flood of its key is lost",
        ),
        Mutant("return [*stops.values(), *newest]", "return newest", "a Stop before eight setpoints is lost"),
        Mutant(
            "                stops.pop(words, None)",
            "                pass",
            "a Stop is taken before an older one that differs",
        ),
        Mutant("PASSES: Final = 4", "PASSES: Final = 1", "an older start overtakes a newer Stop of another key"),
        Mutant("while len(found) < self.depth and", "while", "a flood of one key holds the loop"),
        Mutant(
            "while len(found) < self.depth and",
            "while len(found) < 1 and",
            "of two messages of a key, the second waits",
        ),
        Mutant(
            "key: (Ring(key, 2 * places[key], put, depth), Ring(key, 2 * places[key] + 1, get, RING_DEPTH))",
            "key: (Ring(key, -2 * places[key], put, depth), Ring(key, -2 * places[key] + 1, get, RING_DEPTH))",
            "several keys apply in the wrong order",
        ),
        Mutant(
            "        if keys and not self.instant_open:\n",
            "        if keys:\n",
            "in a flood, an older start overtakes a Stop",
        ),
        Mutant(
            "                    again.remove(ring)  # it is read now",
            "                    pass  # it is read now",
            "a ring is read twice for nothing",
        ),
        Mutant(
            "                        again |= ring.others\n",
            "                        again |= ring.before\n",
            "an older start overtakes a newer Stop of a wider key",
        ),
        Mutant(
            "                        again |= ring.before\n",
            "                        pass\n",
            "a set of several legs overtakes a newer one of its leg",
        ),
        Mutant(
            "if other.place < ring.place)",
            "if other.place > ring.place)",
            "a set of several legs overtakes a newer one of its leg",
        ),
        Mutant(
            "if other.place < ring.place)",
            "if True)",
            "each setpoint looks into eleven rings",
        ),
        Mutant(
            "            due = again\n            if not due:\n                break\n",
            "            break\n",
            "an older start overtakes a newer Stop of another key",
        ),
        Mutant(
            "        self.instant_open = bool(due) and stops",
            "        self.instant_open = False",
            "in a flood, an older start overtakes a Stop",
        ),
        Mutant(
            "        self.instant_open = bool(due) and stops",
            "        self.instant_open = stops",
            "after each Stop its instant stays open: a start is rejected",
        ),
        Mutant(
            "        self.instant_open = bool(due) and stops",
            "        self.instant_open = bool(due)",
            "in a flood of setpoints, nothing that was stopped can be started",
        ),
        Mutant(
            "            taken.sort(key=_place)\n",
            "            pass\n",
            "keys apply in the order in which they happened to be read",
        ),
        Mutant(
            "            taken.sort(key=_place)\n",
            "            taken.sort(key=_place, reverse=True)\n",
            "several keys apply in the wrong order",
        ),
    ),
)
