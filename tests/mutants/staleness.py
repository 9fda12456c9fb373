"""Mutants of gateway/robot/core/staleness.py: what is too old to be executed."""

from tests.mutants.mutant import Mutant, Subject

STALENESS = Subject(
    "gateway/robot/core/staleness.py",
    tests=(
        "tests/unit/robot/test_staleness.py",
        "tests/unit/robot/test_staleness_clocks.py",
        "tests/unit/robot/test_staleness_pauses.py",
    ),
    mutants=(
        Mutant("SOURCES: Final = 256", "SOURCES: Final = 100_000", "invented names fill the memory"),
        Mutant("CLOCKS: Final = 8", "CLOCKS: Final = 800", "invented clocks fill the memory"),
        Mutant(
            "FORGET_MS: Final = 60_000.0", "FORGET_MS: Final = 1000.0", "its burst comes after a source is forgotten"
        ),
        Mutant("HORIZON_MS: Final = 20_000.0", "HORIZON_MS: Final = 1000.0", "another program's burst is let in"),
        Mutant("HORIZON_MS: Final = 20_000.0", "HORIZON_MS: Final = 90_000.0", "a restart locks out for five seconds"),
        Mutant("DRIFT: Final = 200e-6", "DRIFT: Final = 0.0", "a slow clock is locked out after a while"),
        Mutant("DRIFT: Final = 200e-6", "DRIFT: Final = 0.01", "after a silence, a burst passes for fresh"),
        Mutant("FALL: Final = 0.25", "FALL: Final = 100.0", "a forged command moves its owner's baseline"),
        Mutant("STEADY_MS: Final = 5000.0", "STEADY_MS: Final = 500.0", "a queue that empties passes for a longer way"),
        Mutant("GAP_MS: Final = 1000.0", "GAP_MS: Final = 1e9", "bursts with pauses between pass for a longer way"),
        Mutant(
            "LEAST_PAUSE_MS: Final = 250.0", "LEAST_PAUSE_MS: Final = 50.0", "the loop's usual turns count as pauses"
        ),
        Mutant("max(max_age_ms, LEAST_PAUSE_MS)", "LEAST_PAUSE_MS", "a pause shorter than the limit counts"),
        Mutant("        self._turned_ms = now_ms\n", "", "no pause is noticed"),
        Mutant("> self._pause_ms:", "> 2 * self._pause_ms:", "pauses just above the limit are not noticed"),
        Mutant("        self.turned(now_ns)\n", "", "a pause between two messages of an instant is not noticed"),
        Mutant(
            "            return self._after_a_pause(now_ms, now_ms) if self._woke_ms is not None else None\n",
            "            return None\n",
            "after a pause, what says nothing of its age is executed",
        ),
        Mutant(
            "        clocks = self._clocks_of(name, instant_ns / 1e6)\n",
            "        clocks = self._clocks_of(name, now_ms)\n",
            "of one instant, an older command of another key passes for a new clock's",
        ),
        Mutant(
            "        if clocks is None:\n            return (", "        if False:\n            return (", "it raises"
        ),
        Mutant(
            "if difference_ms >= clock.highest_ms - FALL * self._max_age_ms]",
            "if True]",
            "a forged command moves its owner's baseline",
        ),
        Mutant(
            "if difference_ms >= clock.highest_ms - FALL",
            "if difference_ms >= clock.baseline_ms - FALL",
            "a clock is pushed ahead little by little",
        ),
        Mutant(
            "in_order = [clock for clock in fitting if sent_ms >= clock.newest_before_ms]",
            "in_order = fitting",
            "two clocks are taken for one",
        ),
        Mutant(
            "if difference_ms - clock.baseline_ms <= HORIZON_MS]", "if True]", "a clock that jumps back is locked out"
        ),
        Mutant(
            "        clock.newest_sent_ms = max(clock.newest_sent_ms, sent_ms)\n",
            "        clock.newest_sent_ms = sent_ms\n",
            "after an old command that is let in, an older one of another clock is let in, too",
        ),
        Mutant(
            "            clock = max(near, key=_heard_last)\n",
            "            clock = near[0]\n",
            "an old command is judged by a clock that is behind its own",
        ),
        Mutant(
            "        if delay_ms > self._max_age_ms:\n",
            "        if delay_ms >= self._max_age_ms:\n",
            "a delay of just what is allowed is rejected",
        ),
        Mutant(
            "        clock.baseline_ms = min(clock.baseline_ms, difference_ms)\n",
            "",
            "the baseline rises by the drift for ever",
        ),
        Mutant(
            "        clock.highest_ms = max(clock.highest_ms, clock.baseline_ms)\n",
            "",
            "a slow clock's owner can be pushed out after a day",
        ),
        Mutant("        if delay_ms > self._max_age_ms:\n", "        if False:\n", "nothing is too old"),
        Mutant("            clock.fresh_ms = now_ms\n            if", "            if", "no clock proves itself"),
        Mutant(
            "            if clock.stretch is not None and not clock.stretch.overtaken:\n                clock.stretch = None\n",
            "",
            "stalls again and again pass for a longer way",
        ),
        Mutant(
            "if clock.stretch is not None and not clock.stretch.overtaken:",
            "if clock.stretch is not None:",
            "the slower of two machines is locked out for ever",
        ),
        Mutant(
            "known_since_ms < self._woke_ms or",
            "known_since_ms <= now_ms or",
            "after a pause, everything is executed",
        ),
        Mutant("known_since_ms < self._woke_ms or", "", "after a pause, nobody is taken"),
        Mutant("or now_ms - self._woke_ms > self._max_age_ms:", ":", "after a pause, no stranger is ever taken"),
        Mutant("< FORGET_MS:\n", "< 0:\n", "a source is forgotten while its burst may come"),
        Mutant("                del self._sources[oldest]\n", "", "sources are not bounded"),
        Mutant(
            "        self._sources.move_to_end(name)\n", "", "one that is heard is forgotten before one that is not"
        ),
        Mutant("                clock.baseline_ms += rise_ms\n", "", "a slow clock is locked out after a while"),
        Mutant(
            "                clock.newest_before_ms = clock.newest_sent_ms\n",
            "                pass\n",
            "two clocks are taken for one",
        ),
        Mutant(
            "        last = max(clocks, key=_heard_last)\n",
            "        last = clocks[0]\n",
            "a clock long gone is believed",
        ),
        Mutant(
            "        return longest if difference_ms - longest.baseline_ms <= self._max_age_ms else last\n",
            "        return last\n",
            "an owner who was silent is locked out by a forged clock",
        ),
        Mutant(
            "        longest = max(clocks, key=lambda clock: (clock.proven_ms, clock.fresh_ms))\n",
            "        longest = max(clocks, key=lambda clock: clock.baseline_ms)\n",
            "a clock that was first heard with a delay lets old commands in",
        ),
        Mutant(
            "clocks.remove(min(clocks, key=lambda clock: (clock.proven_ms, clock.fresh_ms)))",
            "clocks.pop(0)",
            "invented clocks push out the owner's",
        ),
        Mutant(
            "            return self._new_clock(clocks, sent_ms, now_ms)\n",
            "            pass\n",
            "the faster of two machines loses its baseline",
        ),
        Mutant("        stretch.last_ms = now_ms\n", "", "a longer way is never taken for one"),
        Mutant(
            "        stretch.overtaken = stretch.overtaken or overtaken\n",
            "",
            "a restart's stretch ends with its own first commands",
            equivalent="the first of a stretch decides, unless a restart catches up with its newest: then it fits anyway",
        ),
        Mutant(
            "min(stretch.smallest_ms, difference_ms)", "difference_ms", "a queue that empties passes for a longer way"
        ),
        Mutant(
            "max(stretch.largest_ms, difference_ms)", "difference_ms", "a queue that empties passes for a longer way"
        ),
        Mutant("stretch.begun_ms >= STEADY_MS", "stretch.begun_ms > 1e12", "a longer way locks out for ever"),
    ),
)
