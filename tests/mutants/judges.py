"""Which tests judge which file: those that find most come first. All run in one process, without sleeping."""

from typing import Final

_UNIT: Final = "tests/unit/robot/"
_MODEL: Final = "tests/unit/model/"
_CONDUCTOR: Final = (
    f"{_UNIT}test_conductor.py",
    f"{_UNIT}test_conductor_safety.py",
    f"{_UNIT}test_lease_conductor.py",
    "tests/zenoh/test_conductor_counts.py",
    f"{_MODEL}test_staleness.py",
    f"{_UNIT}test_calibration_conductor.py",
    f"{_UNIT}test_outcome.py",
    f"{_UNIT}test_stop.py",
    f"{_UNIT}test_ownership.py",
    "tests/unit/test_setting_effects.py",
    "tests/unit/people/test_recorder.py",
)
_INBOX: Final = (
    "tests/zenoh/test_inbox_wakeups.py",
    "tests/zenoh/test_inbox_parts.py",
    f"{_UNIT}test_ownership.py",
)
_SUPERVISOR: Final = (
    f"{_UNIT}test_supervisor_at_rest.py",
    f"{_UNIT}test_supervisor.py",
    f"{_UNIT}test_supervisor_stops.py",
    f"{_UNIT}test_supervisor_faults.py",
    f"{_UNIT}test_supervisor_speed.py",
    f"{_UNIT}test_supervisor_takeover.py",
    f"{_UNIT}test_supervisor_landing.py",
    f"{_UNIT}test_supervisor_calibration.py",
    f"{_UNIT}test_supervisor_whole.py",
    f"{_UNIT}test_body_limits.py",
    f"{_UNIT}test_power_rule.py",
    "tests/zenoh/test_supervisor_outside.py",
    f"{_UNIT}test_lease.py",
    f"{_UNIT}test_buttons.py",
    f"{_UNIT}test_latch.py",
    f"{_UNIT}test_backlog.py::test_the_fourth_message_in_one_slot_is_a_burst_and_no_start_of_it_is_ever_sent",
    f"{_UNIT}test_backlog.py::test_a_scene",
    f"{_UNIT}test_conductor.py",
    f"{_UNIT}test_conductor_safety.py",
)
_CALIBRATION: Final = (
    f"{_MODEL}test_calibration.py",
    f"{_UNIT}test_supervisor_calibration.py",
    f"{_UNIT}test_supervisor_landing.py",
    f"{_UNIT}test_calibration_conductor.py",
)
_CALIBRATION_REQUESTS: Final = (
    f"{_UNIT}test_calibration_intake.py",
    f"{_UNIT}test_calibration_conductor.py",
    "tests/zenoh/test_calibration.py",
)
_LEASE: Final = (f"{_UNIT}test_lease.py", f"{_UNIT}test_lease_conductor.py")
_CHECKER: Final = ("tests/unit/people/test_lease_checker.py", f"{_UNIT}test_lease_conductor.py")
_BUS: Final = (
    f"{_UNIT}test_bus_failing.py",
    f"{_UNIT}test_bus.py",
    f"{_UNIT}test_bus_device.py",
    f"{_UNIT}test_conductor.py",
    f"{_UNIT}test_conductor_safety.py",
    "tests/unit/test_setting_effects.py",
    f"{_UNIT}test_slow_failures.py",
)
_POWER: Final = (
    f"{_UNIT}test_power_scenes.py",
    f"{_UNIT}test_power_board.py",
    f"{_UNIT}test_power_conductor.py",
)
_PEOPLE: Final = "tests/unit/people/"
_TIMES: Final = f"{_PEOPLE}test_times.py"

JUDGES: Final = {
    "gateway/model/frames.py": (f"{_MODEL}test_frames.py", "tests/unit/test_decode.py"),
    "gateway/model/framing.py": (f"{_MODEL}test_framing.py",),
    "gateway/model/elkapod.py": (f"{_MODEL}test_elkapod_bytes.py", f"{_UNIT}test_elkapod_wire.py"),
    "gateway/robot/protocol/elkapod.py": (f"{_UNIT}test_elkapod_fed_singly.py", f"{_UNIT}test_elkapod_wire.py"),
    "gateway/robot/spi/cyclic.py": (
        f"{_UNIT}test_elkapod_wire.py",
        f"{_UNIT}test_elkapod_fed_singly.py",
        f"{_UNIT}test_elkapod_conductor.py",
        f"{_UNIT}test_power_conductor.py",
    ),
    "gateway/robot/spi/guard.py": (
        f"{_UNIT}test_guard.py",
        f"{_UNIT}test_bus_device.py",
    ),
    "gateway/robot/spi/awaited.py": _BUS,
    "gateway/robot/spi/bus.py": _BUS,
    "gateway/robot/spi/stop_all.py": (f"{_UNIT}test_stop.py",),
    "gateway/endpoints.py": (f"{_UNIT}test_exposure.py",),
    "gateway/robot/zenoh_io/exposure.py": (f"{_UNIT}test_exposure.py",),
    "gateway/certs/access.py": ("tests/unit/test_access.py",),
    "gateway/certs/zenoh_files.py": (
        "tests/unit/test_access.py",
        "tests/unit/people/test_certs.py",
    ),
    "gateway/certs/proof.py": _CHECKER,
    "gateway/robot/zenoh_io/inbox.py": _INBOX,
    "gateway/robot/zenoh_io/rings.py": ("tests/zenoh/test_rings.py", *_INBOX),
    "gateway/robot/zenoh_io/receiver.py": (f"{_UNIT}test_ownership.py", "tests/zenoh/test_inbox_parts.py"),
    "gateway/robot/runtime/request_answers.py": (
        *_CHECKER,
        f"{_UNIT}test_lease_conductor.py",
        *_CALIBRATION_REQUESTS,
    ),
    "gateway/robot/host/ownership.py": (f"{_UNIT}test_ownership.py", "tests/zenoh/test_inbox_parts.py"),
    "gateway/robot/core/message.py": (f"{_UNIT}test_conductor_safety.py",),
    "gateway/robot/core/intake.py": (
        f"{_UNIT}test_intake.py",
        f"{_UNIT}test_calibration_intake.py",
        f"{_UNIT}test_conductor.py",
        f"{_UNIT}test_conductor_safety.py",
    ),
    "gateway/model/staleness.py": (f"{_MODEL}test_staleness.py",),
    "gateway/robot/core/pacing.py": (
        f"{_UNIT}test_pacing.py",
        f"{_UNIT}test_backlog.py",
        f"{_UNIT}test_supervisor.py",
        f"{_UNIT}test_supervisor_takeover.py",
        f"{_UNIT}test_supervisor_faults.py",
    ),
    "gateway/robot/core/speed.py": (
        f"{_UNIT}test_pacing.py",
        f"{_UNIT}test_supervisor_speed.py",
        f"{_UNIT}test_supervisor_takeover.py",
    ),
    "gateway/robot/core/landing.py": (f"{_UNIT}test_pacing.py", f"{_UNIT}test_supervisor_landing.py"),
    "gateway/robot/core/leg.py": (*_SUPERVISOR, "tests/unit/test_setting_effects.py"),
    "gateway/robot/core/legs.py": _SUPERVISOR,
    "gateway/robot/core/supervisor.py": _SUPERVISOR,
    "gateway/robot/core/interlock.py": _SUPERVISOR,
    "gateway/robot/core/watchdog.py": (*_SUPERVISOR, f"{_UNIT}test_supervisor_landing.py"),
    "gateway/robot/core/outside.py": (*_SUPERVISOR, "tests/zenoh/test_supervisor_outside.py"),
    "gateway/robot/core/power_rule.py": (f"{_UNIT}test_power_rule.py", f"{_UNIT}test_power_conductor.py"),
    "gateway/robot/core/lease.py": _LEASE,
    "gateway/robot/core/buttons.py": (f"{_UNIT}test_buttons.py", f"{_UNIT}test_lease_conductor.py"),
    "gateway/robot/core/power.py": (f"{_UNIT}test_power_rule.py", f"{_UNIT}test_power_conductor.py"),
    "gateway/robot/core/rest.py": (f"{_UNIT}test_supervisor_at_rest.py", f"{_UNIT}test_supervisor_stops.py"),
    "gateway/robot/core/backlog.py": (f"{_UNIT}test_backlog.py",),
    "gateway/robot/core/latch.py": (
        f"{_UNIT}test_latch.py",
        f"{_UNIT}test_supervisor_stops.py",
        f"{_UNIT}test_power_rule.py",
    ),
    "gateway/model/power_board.py": (f"{_MODEL}test_power_board_bytes.py", f"{_UNIT}test_simulated_board.py"),
    "gateway/robot/power/board.py": _POWER,
    "gateway/robot/power/errors.py": (f"{_UNIT}test_power_parts.py",),
    "gateway/robot/power/offs.py": (f"{_UNIT}test_power_parts.py",),
    "gateway/robot/power/questions.py": (f"{_UNIT}test_power_parts.py", *_POWER),
    "gateway/robot/power/currents.py": (f"{_UNIT}test_power_parts.py",),
    "gateway/robot/power/last_cut.py": (f"{_UNIT}test_last_cut.py",),
    "gateway/robot/runtime/supply.py": (
        f"{_UNIT}test_power_conductor.py",
        f"{_UNIT}test_supply_rules.py",
        f"{_UNIT}test_conductor.py",
        f"{_UNIT}test_supply.py",
    ),
    "gateway/robot/core/body_limits.py": (f"{_UNIT}test_body_limits.py",),
    "gateway/nonces.py": ("tests/unit/people/test_lease_checker.py",),
    "gateway/robot/zenoh_io/proofs.py": ("tests/unit/people/test_lease_checker.py",),
    "gateway/model/angle_limits.py": (*_CALIBRATION, f"{_UNIT}test_supervisor_speed.py"),
    "gateway/robot/core/calibrating.py": _CALIBRATION,
    "gateway/model/calibration.py": (*_CALIBRATION, f"{_UNIT}test_calibration_intake.py"),
    "gateway/robot/core/calibration_intake.py": _CALIBRATION_REQUESTS,
    "gateway/robot/core/targets.py": (f"{_UNIT}test_intake.py",),
    "gateway/robot/core/flat.py": (f"{_UNIT}test_intake.py",),
    "gateway/robot/core/losses.py": (f"{_UNIT}test_rejected_stops.py", f"{_UNIT}test_conductor_safety.py"),
    "gateway/robot/runtime/calibrations.py": _CALIBRATION_REQUESTS,
    "gateway/robot/runtime/answers.py": (*_CONDUCTOR, f"{_PEOPLE}test_recorder.py", f"{_UNIT}test_power_conductor.py"),
    "gateway/robot/runtime/executor.py": (*_CONDUCTOR, f"{_UNIT}test_conductor.py"),
    "gateway/robot/runtime/conductor.py": (
        *_CONDUCTOR,
        f"{_UNIT}test_conductor.py",
        f"{_UNIT}test_telemetry.py",
        f"{_UNIT}test_elkapod_conductor.py",
        f"{_UNIT}test_power_conductor.py",
    ),
    # rules of the people's wing, with the time as an argument
    "gateway/allowance.py": ("tests/unit/test_allowance.py",),
    "gateway/people/ros2/own_stop.py": (f"{_PEOPLE}test_ros2_own_stop.py", _TIMES),
    "gateway/people/client/confirmed_stop.py": (
        f"{_PEOPLE}test_confirmed_stop.py",
        f"{_PEOPLE}test_stop_status.py",
        f"{_PEOPLE}test_console_stops.py",
        _TIMES,
    ),
    "gateway/people/client/pace.py": (f"{_PEOPLE}test_client_times.py", f"{_PEOPLE}test_stream.py", _TIMES),
    "gateway/people/client/patience.py": (f"{_PEOPLE}test_client_times.py", _TIMES),
    "gateway/people/client/renewal.py": (f"{_PEOPLE}test_lease_renewal.py", _TIMES),
    "gateway/people/client/silence.py": (f"{_PEOPLE}test_client_times.py", _TIMES),
    "gateway/people/console/pages/presence.py": (f"{_PEOPLE}test_client_times.py", _TIMES),
    "gateway/people/walking/tempo.py": (f"{_PEOPLE}test_ride_script.py", _TIMES),
    "gateway/people/walking/words.py": (f"{_PEOPLE}test_words.py", _TIMES),
    "gateway/people/walking/ride.py": (
        f"{_PEOPLE}test_ride.py",
        f"{_PEOPLE}test_ride_again.py",
        f"{_PEOPLE}test_ride_course.py",
        f"{_PEOPLE}test_ride_script.py",
        _TIMES,
    ),
}
"""What keeps the robot safe, in the order of the way back: what stays longest comes first."""
