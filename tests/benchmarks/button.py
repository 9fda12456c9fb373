"""What a stop button costs a command: two gateways at once, one with a button that is required and alive."""

from contextlib import ExitStack
from pathlib import Path
from statistics import median

from gateway.people.tools.button.check_ins import CheckIns
from tests.benchmarks.beside import measure, started
from tests.benchmarks.processes import say
from tests.benchmarks.table import Row, ratio_row

MESSAGES_HZ = 300
MOST_SHARE = 0.02
"""Of a core: four check-ins a second, of 1 to 2 ms each on a busy machine."""
MOST_P99 = 1.5


def button(folder: Path) -> list[Row]:
    """Six legs at 50 Hz. In the column of the naive script: a gateway that requires no button."""
    say("stop button: two gateways, one with a button alive")
    with ExitStack() as stack:
        sides = started(folder, stack, {"buttons": {"required": 1}})
        client, _ = (side.subject.client() for side in sides)
        alive = client.button("kitchen")
        alive.register()
        alive.alive()  # before anything is commanded
        check_ins = CheckIns(alive, lambda: True, lambda: client.state().uptime_s)
        check_ins.start()
        stack.callback(check_ins.end)
        measure(sides)
        state = client.state()
    ours, theirs = sides
    share = median(with_us - us for with_us, us in zip(ours.cpu_us, theirs.cpu_us, strict=True)) * MESSAGES_HZ / 1e6
    name = "one stop button alive, six legs at 50 Hz"
    return [
        ratio_row(f"{name}: CPU time a message (beside: without)", ours.cpu_us, theirs.cpu_us, "µs", None),
        Row(
            f"{name}: CPU time that it adds, of a core",
            f"{share:.1%}",
            "",
            f"at most {MOST_SHARE:.0%}",
            share <= MOST_SHARE,
        ),
        ratio_row(f"{name}: p50", ours.p50_us, theirs.p50_us, "µs", None),
        ratio_row(f"{name}: p99", ours.p99_us, theirs.p99_us, "µs", MOST_P99),
        Row(f"{name}: commands rejected", str(state.commands.rejected), "", "0", state.commands.rejected == 0),
    ]
