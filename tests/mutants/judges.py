"""Which tests judge which file: those that find most come first. All run in one process, without sleeping."""

from functools import partial
from typing import Final


def _tests(folder: str, names: str) -> tuple[str, ...]:
    return tuple(f"tests/{folder}/test_{name}.py" for name in names.split())


_robot: Final = partial(_tests, "unit/robot")
_model: Final = partial(_tests, "unit/model")
_people: Final = partial(_tests, "unit/people")
_BACKLOG: Final = _robot("backlog")[0]
_SETTINGS: Final = _tests("unit", "setting_effects")
_CONDUCTOR: Final = (
    *_robot("conductor conductor_safety rejected_stops lease"),
    *_model("staleness"),
    *_robot("calibration_conductor last_cut ownership"),
    *_SETTINGS,
    *_people("recorder"),
)
_INBOX: Final = (*_tests("zenoh", "inbox_parts"), *_robot("ownership"))
_SUPERVISOR: Final = (
    *_robot("supervisor_stops supervisor supervisor_speed"),
    *_robot("supervisor_landing supervisor_calibration body_limits power_rule"),
    *_robot("lease buttons"),
    f"{_BACKLOG}::test_a_dead_programs_backlog_starts_nothing",
    f"{_BACKLOG}::test_a_scene",
    *_robot("conductor conductor_safety"),
)
_CALIBRATION: Final = (
    *_model("calibration"),
    *_robot("supervisor_calibration supervisor_landing calibration_conductor"),
)
_CALIBRATION_REQUESTS: Final = (*_robot("calibration_conductor"), *_tests("zenoh", "calibration"))
_CHECKER: Final = (*_people("lease_checker"), *_robot("lease"))
_BUS: Final = (*_robot("bus conductor conductor_safety"), *_SETTINGS, *_robot("slow_failures"))
_POWER: Final = _robot("power_board power_conductor")
_WALKING: Final = _people("walking_robot walking_gait walking_balance ride client_times")
_CYCLIC: Final = _robot("elkapod_wire elkapod_conductor power_conductor")

JUDGES: Final = {
    "gateway/model/frames.py": (*_model("frames"), *_people("commands")),
    "gateway/model/elkapod.py": (*_model("bytes"), *_robot("elkapod_wire")),
    "gateway/robot/protocol/elkapod.py": _CYCLIC,
    "gateway/robot/spi/cyclic.py": _CYCLIC,
    "gateway/robot/spi/guard.py": _robot("guard bus"),
    "gateway/robot/spi/awaited.py": _BUS,
    "gateway/robot/spi/bus.py": _BUS,
    "gateway/robot/spi/stop_all.py": _robot("last_cut"),
    "gateway/zenoh/endpoints.py": _robot("exposure"),
    "gateway/robot/zenoh_io/exposure.py": _robot("exposure"),
    "gateway/certs/access.py": (*_tests("unit", "access"), *_people("certs")),
    "gateway/certs/proof.py": _CHECKER,
    "gateway/robot/zenoh_io/inbox.py": _INBOX,
    "gateway/robot/zenoh_io/rings.py": (*_tests("zenoh", "rings"), *_INBOX),
    "gateway/robot/zenoh_io/receiver.py": (*_robot("ownership"), *_tests("zenoh", "inbox_parts")),
    "gateway/robot/runtime/request_answers.py": (*_CHECKER, *_CALIBRATION_REQUESTS),
    "gateway/robot/host/ownership.py": (*_robot("ownership"), *_tests("zenoh", "inbox_parts")),
    "gateway/robot/core/message.py": _robot("conductor_safety"),
    "gateway/robot/core/intake.py": _robot("intake rejected_stops conductor conductor_safety"),
    "gateway/model/staleness.py": _model("staleness"),
    "gateway/robot/core/servo.py": (*_robot("pacing supervisor_speed supervisor_landing"), *_SUPERVISOR),
    "gateway/robot/core/pace.py": _robot("pacing supervisor_speed supervisor_landing"),
    "gateway/robot/core/gates.py": (*_robot("power_rule power_conductor elkapod_conductor"), _BACKLOG, *_SUPERVISOR),
    "gateway/robot/core/leg.py": (*_robot("pacing"), *_SUPERVISOR, *_SETTINGS),
    "gateway/robot/core/legs.py": _SUPERVISOR,
    "gateway/robot/core/supervisor.py": _SUPERVISOR,
    "gateway/robot/core/interlock.py": _SUPERVISOR,
    "gateway/robot/core/watchdog.py": (*_SUPERVISOR, *_robot("supervisor_landing")),
    "gateway/robot/core/outside.py": _SUPERVISOR,
    "gateway/robot/core/power_rule.py": _robot("power_rule power_conductor"),
    "gateway/robot/core/lease.py": _robot("lease"),
    "gateway/robot/core/buttons.py": _robot("buttons lease"),
    "gateway/robot/core/stops.py": _SUPERVISOR,
    "gateway/robot/core/backlog.py": _robot("backlog supervisor_stops supervisor"),
    "gateway/robot/core/latch.py": _robot("supervisor_stops supervisor power_rule estop_file"),
    "gateway/model/power_board.py": (*_model("bytes"), *_robot("simulator")),
    "gateway/robot/power/board.py": _POWER,
    "gateway/robot/power/questions.py": _POWER,
    "gateway/robot/power/last_cut.py": _robot("last_cut"),
    "gateway/robot/runtime/supply.py": _robot("power_board power_conductor conductor power_line"),
    "gateway/robot/core/body_limits.py": _robot("body_limits"),
    "gateway/model/angle_limits.py": (*_CALIBRATION, *_robot("supervisor_speed")),
    "gateway/robot/core/calibrating.py": _CALIBRATION,
    "gateway/model/calibration.py": (*_CALIBRATION, *_robot("calibration_conductor")),
    "gateway/robot/core/rejections.py": _robot("intake conductor conductor_safety lease"),
    "gateway/robot/runtime/calibrations.py": _CALIBRATION_REQUESTS,
    "gateway/robot/runtime/executor.py": (*_CONDUCTOR, *_people("recorder"), *_robot("power_conductor conductor")),
    "gateway/robot/runtime/conductor.py": (
        *_CONDUCTOR,
        *_robot("conductor telemetry elkapod_conductor power_conductor"),
    ),
    "gateway/robot/runtime/estop_keeper.py": _robot("estop_file"),
    "gateway/robot/blackbox/journal.py": _robot("journal"),
    "gateway/onboard/replay.py": _tests("unit/onboard", "replay"),
    "gateway/robot/blackbox/recorder.py": (*_CONDUCTOR, *_robot("incident_copies telemetry"), *_people("ring")),
    # rules of the people's wing, with the time as an argument
    "gateway/rate_limit.py": _tests("unit", "rate_limit"),
    "gateway/people/watching/confirmed_stop.py": _people("stop_status console_pages client_times"),
    "gateway/people/client/pace.py": _people("client_times stream"),
    "gateway/people/client/patience.py": _people("client_times"),
    "gateway/people/client/renewal.py": _people("lease_renewal client_times"),
    "gateway/people/watching/silence.py": _people("client_times"),
    "gateway/people/walking/gait_speed.py": _people("walk_command client_times"),
    "gateway/people/walking/words.py": _people("walk_command client_times"),
    "gateway/people/walking/ride.py": _people("ride walk_command client_times"),
    **{
        f"gateway/people/walking/{room}.py": _WALKING
        for room in ["balance", "engine", "feet", "gaits", "inverse", "motion", "planning", "robot", "transitions"]
    },
}
"""What keeps the robot safe, in the order of the way back: what stays longest comes first."""
