"""Latencies: what the histogram says of a share of them."""

import pytest

from gateway.robot.protocol.latency import Latency


@pytest.mark.parametrize(
    ("latencies_us", "p50", "p99"),
    [
        ([], None, None),
        ([30], 30, 30),
        ([30] * 99 + [4_000], 50, 50),
        ([30] * 98 + [4_000] * 2, 50, 4_000),
        ([60, 150, 150, 150], 150, 150),
        ([60, 900_000], 100, 900_000),
    ],
)
def test_a_share_is_at_most_its_buckets_end_or_the_worst(
    latencies_us: list[int], p50: float | None, p99: float | None
) -> None:
    latency = Latency()
    for each_us in latencies_us:
        latency.record(each_us * 1000)
    assert (latency.at_most_us(0.5), latency.at_most_us(0.99)) == (p50, p99)
