"""Mutants of gateway/robot/host/ownership.py and gateway/robot/edge/receiver.py: who owns the state, and who waits for it."""

from tests.mutants.mutant import Mutant, Subject

_TESTS = ("tests/unit/robot/test_ownership.py", "tests/zenoh/test_inbox_parts.py")

OWNERSHIP = Subject(
    "gateway/robot/host/ownership.py",
    tests=_TESTS,
    mutants=(
        Mutant(
            "        with self._next:\n            self._state.acquire()\n",
            "        self._state.acquire()\n",
            "a thread that is flooded keeps the loop from the state, and systemd from hearing of it",
        ),
        Mutant(
            "        with self._next:\n            self._state.acquire()\n",
            "        self._next.acquire()\n        self._state.acquire()\n",
            "nobody owns the state a second time",
        ),
        Mutant("        if due_s >= self._wakes_s:\n", "        if True:\n", "no deadline is kept"),
        Mutant(
            "        if due_s >= self._wakes_s:\n",
            "        if due_s > self._wakes_s + 1:\n",
            "the loop is woken for each command",
        ),
        Mutant(
            "        if due_s >= self._wakes_s:\n",
            "        if self._wakes_s < math.inf:\n",
            "a Stop is not repeated in time, where a later deadline was set before",
        ),
        Mutant(
            "            self._loop.call_soon_threadsafe(self._told)\n", "            pass\n", "a deadline is overslept"
        ),
        Mutant(
            "            self._wakes_s = due_s\n            self._loop",
            "            self._loop",
            "the loop is woken again and again for one time",
        ),
        Mutant(
            "            if self._due_s > self._loop.time() + EARLY_S:\n                self._place()\n            else:\n",
            "            if True:\n",
            "each timer calls back early, at the first time that it was ever set to",
        ),
        Mutant(
            "            if self._due_s > self._loop.time() + EARLY_S:\n                self._place()\n",
            "            if self._due_s > self._loop.time() + EARLY_S:\n                pass\n",
            "a deadline is overslept once it was moved to a later time",
        ),
        Mutant(
            "                self._due_s = self._wakes_s = math.inf\n                self._callback()\n",
            "                self._callback()\n                self._due_s = self._wakes_s = math.inf\n",
            "what a timer's own call sets is forgotten",
        ),
    ),
)

RECEIVER = Subject(
    "gateway/robot/edge/receiver.py",
    tests=_TESTS,
    mutants=(
        Mutant(
            "                    with self._owner:\n                        pause_s = deal()\n",
            "                    pause_s = deal()\n",
            "two threads write frames at once",
        ),
        Mutant(
            "                    self._tell(error)\n",
            "                    pass\n",
            "the service goes on after a mistake",
        ),
        Mutant(
            "                except Exception as error:\n",
            "                except ZeroDivisionError as error:\n",
            "after one mistake nothing is noticed any more",
        ),
        Mutant(
            "                    del item  # a query",
            "                    pass  # a query",
            "an asker waits for its answer until somebody else asks",
        ),
        Mutant(
            "                    del deal\n",
            "                    pass\n",
            "an asker waits for its answer until somebody else asks",
        ),
        Mutant(
            "                    time.sleep(pause_s)\n",
            "                    pass\n",
            "in a flood, ticks take the processor from what receives",
            equivalent="only slower in a flood, which the benchmark shows",
        ),
        Mutant(
            "return self.thread.is_alive() and self._looks < MOST_LOOKS",
            "return self.thread.is_alive()",
            "a thread that never comes back from a message is not noticed",
        ),
        Mutant(
            "return self.thread.is_alive() and self._looks < MOST_LOOKS",
            "return self._looks < MOST_LOOKS",
            "with a dead receiver the service says that it goes on",
        ),
        Mutant(
            "                self._in_hand_ns = None\n",
            "                pass\n",
            "a gateway to which nobody speaks for 3 s ends itself",
        ),
    ),
)
