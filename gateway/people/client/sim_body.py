"""Whose word on a simulated body counts: that of the process which the gateway's state names."""

import zenoh


def is_of_physics(sample: zenoh.Sample, physics: str | None) -> bool:
    """Whether the process with this Zenoh id has published it. Without access control, anybody may publish there."""
    source = sample.source_info
    return physics is not None and source is not None and str(source.source_id.zid) == physics
