"""Mutants of gateway/robot/runtime/conductor.py: from received messages to written frames."""

from tests.mutants.mutant import Mutant, Subject

CONDUCTOR = Subject(
    "gateway/robot/runtime/conductor.py",
    tests=(
        "tests/unit/robot/test_conductor.py",
        "tests/unit/robot/test_conductor_safety.py",
        "tests/unit/robot/test_lease_conductor.py",
        "tests/zenoh/test_conductor_counts.py",
        "tests/unit/robot/test_staleness_pauses.py",
        "tests/unit/robot/test_preamble.py",
        "tests/unit/test_setting_effects.py",
        "tests/unit/robot/test_stop.py",
        "tests/unit/robot/test_ownership.py",
        "tests/unit/people/test_recorder.py",
    ),
    mutants=(
        Mutant(
            "        if fault is not None:\n            raise fault\n        self._arm()\n",
            "        self._arm()\n",
            "it starts although no Stop could be written",
        ),
        Mutant(
            "        if fault is not None:\n            raise fault\n        self._arm()\n",
            "        if fault is not None:\n            raise fault\n",
            "the first Stops are not repeated",
        ),
        Mutant(
            "            self._reopen()  # a last attempt",
            "            pass  # a last attempt",
            "a bus that has recovered gets no Stop at the end",
        ),
        Mutant(
            "stop_frames = _count(self._step(ShutDown()), Cause.SHUTDOWN)\n        self._arm()\n",
            "stop_frames = _count(self._step(ShutDown()), Cause.SHUTDOWN)\n",
            "the last Stops are not repeated, and the end waits for ever",
        ),
        Mutant("return stop_frames >= len(LEGS)", "return True", "the end is taken for done though a leg got no Stop"),
        Mutant("return stop_frames >= len(LEGS)", "return stop_frames > len(LEGS)", "the end is never taken for done"),
        Mutant(
            "            self._do_what_is_due(instant_ns)  # a full tick",
            "            pass  # a full tick",
            "a deadline waits for a tick that takes long",
        ),
        Mutant(
            "        self._do_what_is_due(instant_ns)\n        self._arm()\n",
            "        self._arm()\n",
            "no watchdog while nobody commands",
        ),
        Mutant(
            "            self._staleness.turned(now_ns)\n",
            "            pass\n",
            "every silence is taken for a pause of the gateway's own",
        ),
        Mutant(
            "self._clock() >= self.supervisor.due_ns:",
            "self._clock() > self.supervisor.due_ns:",
            "woken when due, nothing is done",
        ),
        Mutant(
            "self._clock() >= self.supervisor.due_ns:",
            "instant_ns >= self.supervisor.due_ns:",
            "a deadline waits for a tick that takes long",
        ),
        Mutant(
            "            self._step(TimePassed(), instant_ns)\n",
            "            self._step(TimePassed())\n",
            "what a deadline stops is started by what the same tick had taken",
        ),
        Mutant(
            "echo_of(received.expression)", "received.expression", "an event repeats what a stranger sent, at length"
        ),
        Mutant(
            "source = intent.source or received.source",
            "source = received.source or intent.source",
            "a program cannot say who it is",
        ),
        Mutant(
            "self.answers.reject(received.key, source, received.reply, Reason.STALE, too_old, servos=intent.targets)\n            return\n",
            "self.answers.reject(received.key, source, received.reply, Reason.STALE, too_old, servos=intent.targets)\n",
            "a delayed command is rejected and executed",
        ),
        Mutant(
            "            self._step(Reset(number, source, received.key, intent.estop, intent.lease), instant_ns)\n",
            "            self._step(Reset(number, source, received.key, intent.estop, intent.lease))\n",
            "a reset beats an emergency stop of its instant",
        ),
        Mutant(
            "Reset(number, source, received.key, intent.estop, intent.lease)",
            "Reset(number, source, received.key, intent.estop)",
            "a holder's reset is rejected",
        ),
        Mutant(
            "Command(number, received.channel, intent.targets, source, intent.lease)",
            "Command(number, received.channel, intent.targets, source)",
            "a holder's commands are rejected",
        ),
        Mutant(
            "Reset(number, source, received.key, intent.estop, intent.lease)",
            "Reset(number, source, received.key)",
            "no reset is taken within 2 s",
        ),
        Mutant(
            "Reset(number, source, received.key, intent.estop, intent.lease)",
            "Reset(number, source, received.key, self.supervisor.estops)",
            "a reset that was sent before an emergency stop leaves it",
        ),
        Mutant(
            "            self._step(command, instant_ns, now_ns)\n",
            "            self._step(command, None, now_ns)\n",
            "an older start overtakes a Stop of its instant",
        ),
        Mutant(
            "Command(number, received.channel, intent.targets, source, intent.lease)",
            "Command(number, received.key, intent.targets, source, intent.lease)",
            "a put and a get of one key count as in order: a start overtakes a Stop",
        ),
        Mutant(
            "Command(number, received.channel, intent.targets, source, intent.lease)",
            'Command(number, "", intent.targets, source)',
            "all keys count as in order: a start overtakes a Stop",
        ),
        Mutant(
            "return None if too_old is None or intent.only_stops else too_old",
            "return too_old",
            "a Stop that was delayed on its way is rejected",
        ),
        Mutant(
            "return None if too_old is None or intent.only_stops else too_old",
            "return None",
            "limits.max_age_ms is ignored",
        ),
        Mutant(
            "        if self.supervisor.mode is Mode.BUS_FAULT:\n            self._reopen()\n        stop_frames",
            "        stop_frames",
            "an emergency stop waits until somebody looks for the device again",
        ),
        Mutant(
            "self._step(EmergencyStop(received.source, received.key), instant_ns)",
            "self._step(EmergencyStop(received.source, received.key))",
            "a reset beats an emergency stop of its instant",
        ),
        Mutant(
            "latency_ns = max(0, self._clock() - received.received_ns)",
            "latency_ns = 0",
            "how long a Stop took is not told",
        ),
        Mutant(
            "            self.metrics.emergency_stops.record(latency_ns)\n",
            "            pass\n",
            "how long a Stop took is not measured",
        ),
        Mutant(
            "Ack(accepted=True, stop_frames=stop_frames,",
            "Ack(accepted=True, stop_frames=6,",
            "an answer says that six Stops were written though none was",
        ),
        Mutant(
            "        if fault is not None:\n            self._bus_failed(fault)\n        self._tell_mode()\n        return written",
            "        self._tell_mode()\n        return written",
            "a bus that fails is used on as if nothing had happened",
        ),
        Mutant(
            "            self._bus_failed(fault)\n        self._tell_mode()\n        return written",
            "            self._bus_failed(fault)\n        return written",
            "nobody hears of a change of mode",
        ),
        Mutant("frame.heard and ", "", "a Stop that may not have been heard counts as written"),
        Mutant(
            "                case Completed() if fault is not None:\n",
            "                case Completed() if False:\n",
            "a command whose frame was not written is acknowledged",
        ),
        Mutant(
            "                case Announce(kind=Kind.BUS_RECOVERED) if fault is not None:\n",
            "                case Announce(kind=Kind.BUS_RECOVERED) if False:\n",
            "a bus that did not take its Stops is told as recovered",
        ),
        Mutant("if self._settings.telemetry.frames:", "if True:", "telemetry.frames is ignored"),
        Mutant("        self.bus.close()\n        effects", "        effects", "a device at fault is never released"),
        Mutant(
            "            effects = [effect for effect in effects if not isinstance(effect, Announce)]\n",
            "            pass\n",
            "one fault is told again and again",
        ),
        Mutant(
            "        self._in_fault = True\n", "        self._in_fault = False\n", "one fault is told again and again"
        ),
        Mutant(
            "        self._carry_out(effects)\n        if self.supervisor.mode is Mode.BUS_FAULT:\n",
            "        if self.supervisor.mode is Mode.BUS_FAULT:\n",
            "what was pending in a fault is never answered",
        ),
        Mutant(
            "        if self.supervisor.mode is Mode.BUS_FAULT:\n            self._reopen_later()\n",
            "",
            "a device that is back is not looked for",
        ),
        Mutant(
            "            self._bus_failed(fault)\n        self._tell_mode()\n        self._arm()\n",
            "            pass\n        self._tell_mode()\n        self._arm()\n",
            "a zero that failed is forgotten",
        ),
        Mutant(
            '            logger.debug("the SPI device does not answer yet: %s", error)\n            self._reopen_later()\n',
            '            logger.debug("the SPI device does not answer yet: %s", error)\n',
            "a device that is back is looked for once only",
        ),
        Mutant("        self._step(BusOpened())\n", "        pass\n", "after a fault, servos go on as they were"),
        Mutant(
            "                self._loop.call_soon_threadsafe(self.done.set)\n",
            "                pass\n",
            "the end waits for its time to be over",
        ),
        Mutant(
            "            if self.supervisor.mode is Mode.STOPPING:\n                self._loop",
            "            if self._loop:\n                self._loop",
            "the end does not wait for the repeats",
        ),
        Mutant(
            "        if self._closed:\n            return\n",
            "",
            "a thread that waited for the state writes to a device that has been released",
        ),
        Mutant(
            "for received in self.take() if only is None else only:",
            "for received in self.take():",
            "an emergency stop that no tick has taken is never served",
        ),
        Mutant(
            "        if received.key == keys.ESTOP:\n",
            "        if received.key == keys.ESTOP and received.verb is not Verb.DELETE:\n",
            "a delete does not engage the emergency stop",
        ),
        Mutant(
            "if self._losses.key and (received.key != self._losses.key or received.verb is Verb.GET):",
            "if False:",
            "a start by another way undoes a Stop that was lost",
        ),
        Mutant(
            "        if self._losses.key:\n            self._stop_what",
            "        if False:\n            self._stop_what",
            "a Stop in a flood is lost",
        ),
        Mutant("self._losses.note(received.key)", "pass", "a Stop in a flood is lost"),
        Mutant(
            "            if self._losses.key and self.answers.rejected != number:\n",
            "            if self._losses.key:\n",
            "a start that is rejected undoes a Stop that was lost",
        ),
        Mutant(
            "            if self._losses.key and self.answers.rejected != number:\n",
            "            if False:\n",
            "a flood of starts stops its leg",
        ),
    ),
)

ANSWERS = Subject(
    "gateway/robot/runtime/answers.py",
    tests=CONDUCTOR.tests,
    mutants=(
        Mutant("        self._metrics.accepted += 1\n", "", "accepted commands are not counted"),
        Mutant("        self._metrics.coalesced += completed.coalesced\n", "", "replaced commands are not counted"),
        Mutant(
            "coalesced=True if completed.coalesced else None",
            "coalesced=None",
            "nobody is told that a target was replaced",
        ),
        Mutant("        self._metrics.rejected[reason] += 1\n", "", "rejected commands are not counted"),
        Mutant(
            "            reply(ack.model_dump_json().encode())\n",
            "            pass\n",
            "who is rejected waits for an answer",
        ),
        Mutant(
            "        if left_out is not None:\n            self._tell",
            "        if True:\n            self._tell",
            "a flood of rejected commands is a flood of events",
        ),
    ),
)

LOSSES = Subject(
    "gateway/robot/core/losses.py",
    tests=CONDUCTOR.tests,
    mutants=(
        Mutant("if op.op is OP_START}", "}", "a Set undoes a Stop that was lost"),
        Mutant("if stop[0] not in started)", "if False)", "a start of one servo undoes the Stop of another"),
        Mutant(
            '        self.key, self._stops = "", ()\n',
            "",
            "a leg that was flooded once is asked for with each command",
            equivalent="only slower: what runs later has been started, and is no longer among the Stops",
        ),
    ),
)
