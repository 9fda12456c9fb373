"""The Python client for programs on a laptop; needs neither SPI nor a compiler.

>>> from gateway.client import Client
>>> with Client(endpoint) as robot:                       # such as "tcp/192.0.2.7:7447"
...     robot.start_legs([(90, 45, 120)] * 6).accepted    # acknowledged: the frames have been handed to SPI
...     robot.set_leg(3, 91, 45, 120).accepted            # only what runs can be set
...     robot.stop(3).accepted
...     robot.set_leg(3, 91, 45, 120, check=False).detail # without `check=False` it raises RejectedError
True
True
True
'servo 31 does not run; start it before you set it'
"""

from gateway.errors import (
    DisconnectedError,
    GatewayError,
    LeaseError,
    LeaseLostError,
    OutOfRangeError,
    RejectedError,
    StoppedError,
    WalkError,
    ZenohError,
)
from gateway.people.client.aio import AsyncButton, AsyncClient, AsyncLease, AsyncStream, AsyncWalk
from gateway.people.client.blocking import Client
from gateway.people.client.lease import Lease
from gateway.people.client.lease_requests import Button
from gateway.people.client.pace import Jitter
from gateway.people.client.stream import Stream
from gateway.people.client.walk import Walk
from gateway.people.walking.motion import Odometry, Posture, WalkState
from gateway.words.own_command import DEFAULT_ENDPOINT
from schemas.ack import Ack
from schemas.event import Event, FrameRecord
from schemas.gateway_state import GatewayState
from schemas.telemetry import Battery, Imu, Telemetry
from schemas.words import Kind, Reason

__all__ = [
    "DEFAULT_ENDPOINT",
    "Ack",
    "AsyncButton",
    "AsyncClient",
    "AsyncLease",
    "AsyncStream",
    "AsyncWalk",
    "Battery",
    "Button",
    "Client",
    "DisconnectedError",
    "Event",
    "FrameRecord",
    "GatewayError",
    "GatewayState",
    "Imu",
    "Jitter",
    "Kind",
    "Lease",
    "LeaseError",
    "LeaseLostError",
    "Odometry",
    "OutOfRangeError",
    "Posture",
    "Reason",
    "RejectedError",
    "StoppedError",
    "Stream",
    "Telemetry",
    "Walk",
    "WalkError",
    "WalkState",
    "ZenohError",
]
