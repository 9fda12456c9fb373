"""Schedules Stops for legs at rest (Behaviour *Legs at rest*). Pure; time is an argument.

A controller that lost bytes may run a servo that was not started. So legs at rest get Stops: a round every
`Rules.rest_ns` while other legs run, and a few more runs some time after the last Stop and its repeats. A set time is
not postponed, since it could be postponed forever.
"""

from gateway.robot.core.leg import Rules


class RestStops:
    """The next round or run of Stops, and how many runs are left."""

    def __init__(self, rules: Rules) -> None:  # mutants accepted (Step): the first Stop sets both
        self._rules = rules
        self._settled_ns = 0
        """When runs begin to count, after the last Stop and its repeats."""
        self._runs_left = 0
        self.runs = rules.rest_runs + 1 if rules.rest_runs else 0
        """The number of runs after a Stop while nothing runs; 0 once the service ends, which waits for none."""
        self.due_ns: int | None = None
        """When legs at rest get their next Stop, or None."""

    # mutants accepted (Gt_GtE, Step): equal times; the next Stop sets the runs anew
    def plan(self, now_ns: int, *, at_rest: bool, stopped: bool) -> None:
        """Set the next time at the end of a step. `at_rest`: nothing runs; `stopped`: a servo got a first Stop.

        A leg that starts ends the runs and begins the rounds.
        """
        rules = self._rules
        if not at_rest:
            self._runs_left, self.due_ns = 0, now_ns + rules.rest_ns
            return
        if stopped:
            settle_ns = rules.repeats * rules.repeat_interval_ns + rules.rest_run_ns
            self._runs_left, self._settled_ns = self.runs, now_ns + settle_ns
        if not self._runs_left:
            self.due_ns = None
        elif self.due_ns is None:
            next_ns = now_ns + rules.rest_run_ns
            self.due_ns = self._settled_ns if self._settled_ns > next_ns else next_ns

    def take(self, now_ns: int, *, is_run: bool) -> bool:
        """Record Stops that leave now; `is_run`: they are a due run. Return whether it is the last run."""
        self.due_ns = None
        if not is_run or now_ns < self._settled_ns:
            return False
        self._runs_left -= 1
        return self._runs_left == 0

    def forget(self) -> None:
        """Cancel all Stops after a bus fault. The next opening of the bus stops all legs."""
        self.due_ns, self._runs_left = None, 0
