"""The words of the interface, and what they mean: reasons, modes, kinds of events, causes."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field


class Value(StrEnum):
    """A text that the interface defines. `meaning` explains it in the docs."""

    meaning: str

    def __new__(cls, value: str, meaning: str = "") -> Self:
        member = str.__new__(cls, value)
        member._value_, member.meaning = value, meaning
        return member


class Reason(Value):
    """Why a command was rejected."""

    TOO_LARGE = "too_large", "the payload has more than 4096 bytes"
    BAD_ENCODING = "bad_encoding", "the encoding is not JSON"
    MALFORMED = "malformed", "the payload is not JSON"
    INVALID = "invalid", "a field is missing, unknown or out of range, or there is no such key"
    SERVO_STOPPED = "servo_stopped", "a `set` names a stopped servo, a Stop arrived too, or its calibration is in doubt"
    JOINT_LIMIT = "joint_limit", "the angle is outside the servo's limits, or is never sent"
    STALE = "stale", "it was delayed for too long, belongs to a burst, names an old calibration, or repeats a check-in"
    ESTOPPED = "estopped", "the emergency stop is engaged, or a reset names another one"
    BUS_FAULT = "bus_fault", "the controller cannot be reached"
    STOPPING = "stopping", "the gateway ends"
    NOT_HOLDER = "not_holder", "somebody else holds the lease, or its own has ended"
    NO_LEASE = "no_lease", "nobody holds the lease, and it is required or asked for"
    LEASE_HELD = "lease_held", "the lease is not free"
    LEASE_DENIED = "lease_denied", "the name is not proved, or the lease cannot be taken or handed over"
    LANDING = "landing", "the robot lands"
    OVERFLOW = "overflow", "messages of its key were lost, perhaps a Stop"
    REVOCATION_DENIED = "revocation_denied", "the list is signed by another CA, not newer, or cannot be kept"
    NO_BUTTON = "no_button", "too few buttons are alive"
    UNKNOWN_BUTTON = "unknown_button", "no button has this token"
    BUTTON_DENIED = "button_denied", "the name is not proved, or its places are taken"
    BATTERY_LOW = "battery_low", "it starts a servo on a low battery"
    WHOLE_ROBOT = "whole_robot", "only all 18 servos together can be started"
    FALLEN = "fallen", "it starts or sets a servo while the body tilts too far"
    NO_POWER = "no_power", "the power board does not answer or does not feed that servo"


class Mode(Value):
    """What the gateway as a whole is doing."""

    STARTING = "starting", "the device is not open yet"
    IDLE = "idle", "commands are accepted; no servo runs"
    ACTIVE = "active", "a servo runs"
    ESTOPPED = "estopped", "the emergency stop is engaged"
    BUS_FAULT = "bus_fault", "the device failed and is being reopened"
    STOPPING = "stopping", "the gateway ends"


class Kind(Value):
    """What an event reports, and whether legs stop by it."""

    stops: bool

    def __new__(cls, value: str, meaning: str = "", stops: bool = False) -> Self:
        member = str.__new__(cls, value)
        member._value_, member.meaning, member.stops = value, meaning, stops
        return member

    STARTED = "started", "commands are accepted from now on"
    COMMAND_REJECTED = "command_rejected", "a command took no effect"
    WATCHDOG_EXPIRED = "watchdog_expired", "a leg was silent and is stopped", True
    ESTOP_ENGAGED = "estop_engaged", "an emergency stop was requested", True
    ESTOP_RESET = "estop_reset", "the emergency stop was left"
    ESTOP_KEPT = "estop_kept", "the gateway started with the emergency stop engaged"
    ESTOP_NOT_KEPT = "estop_not_kept", "the emergency stop, or its end, could not be written to disk"
    BUS_FAULT = "bus_fault", "a transfer failed", True
    BUS_RECOVERED = "bus_recovered", "the device answers again; all servos are stopped"
    STOPPING = "stopping", "the gateway ends", True
    STOPPED_OUTSIDE = "stopped_outside", "`stop-servos` stopped the servos", True
    LEGS_STOPPED = "legs_stopped", "a Stop reached `legs`, which ran or waited to start; `cause` is why", True
    SOURCE_CHANGED = "source_changed", "another source commands or stops a running leg"
    LEASE_ACQUIRED = "lease_acquired", "somebody drives from now on"
    LEASE_RELEASED = "lease_released", "the holder released the lease or handed it over"
    LEASE_EXPIRED = "lease_expired", "the holder, or the nominee, was silent for too long"
    LEASE_TAKEN = "lease_taken", "somebody stopped all legs and took the lease", True
    LEASE_ASKED = "lease_asked", "somebody asks the holder for the lease"
    LANDING = "landing", "the robot goes to its landing pose; `watchdog_expired` follows"
    CALIBRATED = "calibrated", "a changed calibration is in force and kept"
    OVERFLOW = "overflow", "messages of one key were lost, perhaps a Stop: its servos are stopped", True
    BUS_MEDDLED = "bus_meddled", "another program changed the SPI settings; they are restored, and `bus_fault` follows"
    REVOKED = "revoked", "a newer list is in force: the gateway restarts; or the stored list was older"
    BUTTON_REGISTERED = "button_registered", "a button is registered and replaces an older one of its name"
    BUTTON_SILENT = "button_silent", "a button was silent for too long"
    BUTTON_LEFT = "button_left", "a button left"
    BUTTON_RETURNED = "button_returned", "a silent button checks in again"
    CONTROLLER_SILENT = "controller_silent", "heartbeats or answers are missing: all servos are stopped", True
    CONTROLLER_RESTARTED = "controller_restarted", "the controller may have restarted: all servos are stopped", True
    CONTROLLER_RETURNED = "controller_returned", "heartbeats and answers arrive again"
    BATTERY_LOW = "battery_low", "starts are rejected; running servos go on"
    FALLEN = "fallen", "the body tilted too far: all legs stop or land", True
    POWER_CUT = "power_cut", "the power board is to cut the supply of these legs"
    POWER_RESTORED = "power_restored", "servos are fed again"
    POWER_UNCONFIRMED = "power_unconfirmed", "the board has not confirmed the supply off: **switch it off by hand**"
    POWER_FAULT = "power_fault", "a fault of the board, or another program switches servos through it"
    SERVO_DRAWS = "servo_draws", "a stopped servo draws current"
    SERVO_SILENT = "servo_silent", "a running servo draws nothing for 1 s"
    OFF_BUTTON = "off_button", "the board's off button was pressed: all legs are stopped", True


class Cause(Value):
    """Why a frame was written, or legs were stopped."""

    COMMAND = "command", "for a command"
    WATCHDOG = "watchdog", "a leg was silent, or too few buttons were alive"
    ESTOP = "estop", "for an emergency stop"
    STARTUP = "startup", "the device was opened"
    SHUTDOWN = "shutdown", "the gateway ends"
    REPEAT = "repeat", "repeats a Stop"


class WatchdogState(Value):
    """State of a leg's watchdog."""

    IDLE = "idle", "no servo runs or waits to start"
    ARMED = "armed", "silence will stop the leg"
    EXPIRED = "expired", "silence has stopped the leg"


OrText = Field(union_mode="left_to_right")
"""For values that later versions may extend: an unknown one is read as text."""
AnyReason = Annotated[Reason | str, OrText]
AnyMode = Annotated[Mode | str, OrText]
AnyKind = Annotated[Kind | str, OrText]
AnyCause = Annotated[Cause | str, OrText]
AnyWatchdogState = Annotated[WatchdogState | str, OrText]
