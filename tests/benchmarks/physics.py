"""What a simulated body costs: the answers of a gateway while its physics runs, and while that process is suspended."""

import os
import signal
import time
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from gateway.people.physics.pace import WINDOW_S
from schemas.keys import SIM_BODY
from schemas.telemetry import BodyReport
from tests.benchmarks.processes import Figures, cpu_ns, now_ns, rss_kb, say
from tests.benchmarks.subjects import Publisher
from tests.benchmarks.table import Row, ratio_row
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard

ROUNDS = 10
ROUND_S = 3.0
SETTINGS = {"watchdog": {"timeout_ms": 1000}, "limits": {"leg_rate_hz": 100}}
STREAM = ("--legs", *"123456", "--hz", "50", "--shape", "asked")


def physics(folder: Path) -> list[Row]:
    """Six legs are moved at 50 Hz, each time with a question. In the column of the naive script: no physics."""
    with ExitStack() as stack:
        gateway = stack.enter_context(Gateway(folder, SETTINGS, options=("--sim=physics",)))
        (pid,) = map(int, Path(f"/proc/{gateway.child.pid}/task/{gateway.child.pid}/children").read_text().split())
        heard = Heard(stack.enter_context(gateway.client()), SIM_BODY, BodyReport)
        publisher = Publisher(gateway.endpoint, folder / "published", STREAM)
        stack.callback(publisher.child.close)
        publisher.run(0.5)
        found: tuple[list[Figures], list[Figures]] = ([], [])
        shares, factors = [], []
        for number in range(2 * ROUNDS):
            say(f"physics: round {number + 1} of {2 * ROUNDS}")
            suspended = number % 2
            os.kill(pid, signal.SIGSTOP if suspended else signal.SIGCONT)
            if not suspended:
                time.sleep(WINDOW_S)  # what it did not simulate meanwhile is no longer in the factor
            begun_ns, begun_cpu_ns = now_ns(), cpu_ns(pid)
            found[suspended].append(Figures.of(publisher.answers_ns(publisher.run(ROUND_S))))
            if not suspended:
                shares.append((cpu_ns(pid) - begun_cpu_ns) / (now_ns() - begun_ns))
                factors.append(heard.all[-1].real_time_factor)
        os.kill(pid, signal.SIGCONT)
        memory_mb = rss_kb(pid) / 1024
    (with_p50, with_p99), (p50, p99) = (
        ([figures.p50_us for figures in each], [figures.p99_us for figures in each]) for each in found
    )
    title = "six legs, 50 Hz, asked → answered, beside a simulated body"
    return [
        ratio_row(f"{title}: p50", with_p50, p50, "µs", None),
        ratio_row(f"{title}: p99", with_p99, p99, "µs", None),
        Row("physics: CPU of its process, share of one core", f"{median(shares):.0%} (at most {max(shares):.0%})", ""),
        Row("physics: its real-time factor", f"{median(factors):.3f} (at least {min(factors):.3f})", ""),
        Row("physics: memory of its process", f"{memory_mb:.0f} MB", ""),
    ]
