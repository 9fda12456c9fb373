"""Which test runs when, on which worker of `pytest -n`, and which ones alone: decided here for all of them.

`make quick` runs unit tests that are not THOROUGH. `make test` runs what each commit has to show: all unit and property
tests, the wire, for each seam between two processes a scene that fails where the seam is broken, and each attack that
concerns a Stop. `make test-all` adds what searches or repeats: EXTENDED.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

TESTS: Final = Path(__file__).parents[1]
ORDER: Final = (
    "box",
    "console",
    "hil",
    "attack",
    "zenoh",
    "ros2",
    "net",
    "walking",
    "falls",
    "mutants",
    "unit",
    "fuzz",
)
"""Longest chains first, last what is short."""
ALONE: Final = (
    "net",
    "hil/test_death.py",
    "hil/test_load.py",
    "hil/test_landing.py",
    "attack/test_console_strangers.py",
    "attack/test_console_starved.py",
    "attack/test_lease_flood.py",
    "zenoh/test_console_bounds.py",  # fifty pages, and how old what they show may be
    "zenoh/test_replay.py",  # where the machine stalls, a setpoint and the Stop behind it are one instant
)
"""What measures time or fills the machine: `make test` runs these last, one at a time."""
ATTENDED: Final = (
    "console",
    "zenoh/test_walk_command.py",
    "zenoh/test_button_command.py",
    "zenoh/test_watch_terminal.py",
)
"""Pages and terminals with a person at them, who is slow, but not stalled: two at a time, between the others."""
THOROUGH: Final = (
    "unit/people/test_console_listener.py",
    "unit/people/test_recordings.py",
    "unit/people/test_recordings_damaged.py",
    "unit/people/test_walking_gait.py",
    "unit/people/test_walking_postures.py",
    "unit/robot/test_ownership.py",
    "unit/robot/test_power_robot_orders.py",
    "unit/robot/test_slow_failures.py",
    "unit/robot/test_supervisor_machine.py",
)
"""Searches of some seconds, which `make quick` leaves to `make test`."""
EXTENDED: Final = (
    # searches, and matrices of which `make test` has a row
    "falls",
    "fuzz/test_fuzz.py",
    "fuzz/test_model_check.py::test_every_reachable_state_keeps_every_promise",
    "fuzz/test_model_check.py::test_states_that_count_as_one_have_one_future",
    "mutants",
    "walking",
    "attack/test_deaf_controller.py::test_a_firmware_that_rejects_other_lengths_than_6_and_14_survives_them",
    "attack/test_deaf_controller.py::test_what_more_than_one_lost_byte_does_is_known",
    "attack/test_held_back.py::test_a_stream_that_was_held_back_goes_on",
    "hil/test_failing_bus.py::test_an_emergency_stop_on_a_bus_that_takes_200_ms_to_fail[plain-0.1]",
    "hil/test_failing_bus.py::test_an_emergency_stop_on_a_bus_that_takes_200_ms_to_fail[plain-0.2]",
    "hil/test_failing_bus.py::test_an_emergency_stop_on_a_bus_that_takes_200_ms_to_fail[length-prefixed-0.03]",
    "hil/test_failing_bus.py::test_an_emergency_stop_on_a_bus_that_takes_200_ms_to_fail[length-prefixed-0.1]",
    "hil/test_elkapod.py::test_each_fault_shuts_down_is_reported_and_leaves_a_robot_at_rest",
    "hil/test_elkapod_driven.py",
    "hil/test_board_process.py::test_a_flood_of_another_node_leaves_the_board_as_quick_as_it_is",
    "hil/test_board_process.py::test_it_runs_by_itself_and_leaves_nothing_at_its_end",
    "hil/test_incidents.py",
    "hil/test_lists.py::test_check_move_shows_that_a_driver_ignores_cs_change_and_what_to_set",
    "net/test_hosts.py::test_a_stop_finds_the_other_host_in_mid_stream",
    "net/test_silent_loss.py::test_silence_stops_the_legs_and_the_driver_learns_it[toward the laptop]",
    "net/test_silent_loss.py::test_silence_stops_the_legs_and_the_driver_learns_it[toward the robot]",
    "zenoh/test_check.py::test_a_port_is_free_or_taken",
    # floods of strangers, kills in dozens, real priorities under load
    "attack/test_console_strangers.py::test_stop_all_beside_pages_that_flood",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[body-40]",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[chunked-20]",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[get-50]",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[handshake-50]",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[huge_headers-50]",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[link-20]",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[silent-700]",
    "attack/test_console_strangers.py::test_stop_all_beside_strangers[upgrade-50]",
    "attack/test_lease_flood.py",
    "attack/test_slow_metrics.py::test_who_asks_again_and_again_is_answered_so_often_a_second_and_no_more",
    "hil/test_death.py::test_killed_at_random_moments_under_load",
    "hil/test_load.py",
    "zenoh/test_console_bounds.py",
    "zenoh/test_record.py::test_a_killed_recorder_leaves_all_but_the_newest",
    "box/test_power_cut.py",
    # the drill and its planted gateways; releases, and what else may happen to an installation
    "box/test_bundle.py",
    "box/test_pages.py",
    "box/test_check_faults.py",
    "box/test_drill.py",
    "box/test_installer.py::test_a_robot_from_before_there_was_a_framing",
    "box/test_installer.py::test_a_terminal_is_asked_and_the_framing_stays",
    "box/test_installer.py::test_an_installation_that_was_ended_is_noticed",
    "box/test_installer.py::test_another_controller_for_an_installed_robot",
    "box/test_installer.py::test_the_protocol_without_a_framing",
    "box/test_installer.py::test_an_upgrade_that_does_not_start_leaves_the_old_one_running",
    "box/test_installer.py::test_certificates",
    "box/test_installer.py::test_config_txt",
    "box/test_installer.py::test_rejections",
    "box/test_installer.py::test_the_exact_interpreter",
    "box/test_installer.py::test_what_a_power_cut_has_emptied_is_made_anew",
    "box/test_installer.py::test_without_a_compiler",
    "box/test_systemd.py::test_a_configuration_that_the_service_may_not_read",
    "box/test_systemd.py::test_device_that_comes_late",
    "box/test_systemd.py::test_no_device",
    "box/test_systemd.py::test_what_the_recorder_keeps",
    "box/test_systemd_console.py",
    "hil/test_drill.py",
    "box/test_upgrade.py",
    "zenoh/test_drill.py",
    "zenoh/test_release.py",
    "zenoh/test_release_spidev.py",
    # what README, docs and docstrings show
    "zenoh/test_client.py::test_the_examples_run",
    "zenoh/test_examples.py",
    "zenoh/test_first_steps.py::test_a_type_checker_finds_the_types_from_any_folder",
    "zenoh/test_first_steps.py::test_an_unfit_virtual_environment_is_made_anew",
    "zenoh/test_readme.py",
    # comfort: nothing here moves or stops a servo
    "console/test_button.py::test_a_page_whose_timer_comes_once_a_second_is_silent_and_does_not_flutter",
    "console/test_calibration.py::test_a_servo_is_started_alone_jogged_trimmed_turned_round_and_written",
    "console/test_calibration.py::test_it_is_within_reach_of_everybody",
    "console/test_fall.py",
    "console/test_lease.py::test_a_handover_to_a_hidden_page_ends_and_whoever_looks_again_reads_that_it_is_free",
    "console/test_measured.py::test_a_controller_that_is_silent_is_shown_in_red_and_the_strip_stays_on_the_picture",
    "console/test_measured.py::test_a_rejections_reason_is_said_in_plain_words",
    "console/test_measured.py::test_feet_carry_by_comparison_and_the_horizon_turns_as_it_is_seen_from_behind",
    "console/test_measured.py::test_what_is_new_of_such_a_robot_is_said_in_plain_words",
    "console/test_modules.py",
    "console/test_other_browsers.py",
    "console/test_page.py::test_axe_finds_nothing_serious",
    "console/test_page.py::test_eighteen_servos_are_seen_in_three_dimensions_and_in_words",
    "console/test_page.py::test_nothing_flickers_while_nothing_changes",
    "console/test_page.py::test_poses_are_kept_in_the_browser_and_a_space_that_is_typed_into_a_name_stops_nothing",
    "console/test_page.py::test_without_webgl_it_is_drawn_from_above_and_without_physics_there_is_nobody_to_set_upright",
    "console/test_still_page.py",
    "console/test_pad.py::test_a_network_that_is_throttled_while_it_walks_stands_still_until_a_new_press",
    "console/test_pad.py::test_a_second_phone_that_takes_the_lease_while_a_thumb_is_held_stops_all",
    "console/test_pad.py::test_a_driver_has_a_screen_that_stays_on_and_feels_what_ends_a_walk",
    "console/test_pad.py::test_slow_bounds_what_a_thumb_asks_for_at_its_pads_end_and_fast_asks_for_more",
    "console/test_pad.py::test_leaving_the_full_screen_by_a_key_is_stop_all_and_by_its_button_is_not",
    "console/test_pad.py::test_it_installs_as_an_app",
    "console/test_calibration.py::test_on_a_phone_the_pads_in_its_place_end_it",
    "console/test_calibration.py::test_it_begins_where_the_last_test_ended_and_ends_two_minutes_after_the_last_click",
    "console/test_walk.py::test_a_gamepads_sticks_walk_and_its_b_button_is_stop_all",
    "console/test_walk.py::test_on_a_small_phone_nothing_scrolls_to_walk_or_to_stop",
    "console/test_sign_in.py::test_without_its_key_a_page_says_how_to_go_on",
    "zenoh/test_diagnosis.py",
    "zenoh/test_foxglove.py::test_a_gateway_that_ends_and_starts_again_is_reported_in_the_viewers_log",
    "zenoh/test_interrupted.py",
    "zenoh/test_physics.py",
    "zenoh/test_physics_secured.py",
    "zenoh/test_replay.py",
    "zenoh/test_upkeep.py",
    "zenoh/test_drill_power.py::test_one_that_does_not_take_the_supply_fails",
    "zenoh/test_drill_power.py::test_spi_unplugged",
    "zenoh/test_drill_power.py::test_can_unplugged",
    "zenoh/test_walk_interrupted.py::test_the_first_sits_and_the_second_stops[once-async-SIGTERM]",
    "zenoh/test_walk_interrupted.py::test_the_first_sits_and_the_second_stops[once-blocking-SIGTERM]",
    "zenoh/test_walk_interrupted.py::test_the_first_sits_and_the_second_stops[once-by hand-Ctrl-C]",
    "zenoh/test_walk_interrupted.py::test_the_first_sits_and_the_second_stops[twice-async-SIGTERM]",
    "zenoh/test_walk_interrupted.py::test_the_first_sits_and_the_second_stops[twice-blocking-SIGTERM]",
    "zenoh/test_walk_interrupted.py::test_the_first_sits_and_the_second_stops[twice-by hand-Ctrl-C]",
    "zenoh/test_watch_terminal.py::test_a_gateway_that_hangs_and_one_that_dies_are_called_silent_and_come_back",
    "zenoh/test_watch_terminal.py::test_it_waits_for_a_gateway_that_is_not_there_yet_and_asks_one_that_publishes_no_state",
    "ros2/test_rclpy.py::test_a_peer_that_vanishes_in_mid_trajectory_has_the_robot_sit_down[it is killed]",
    "ros2/test_rclpy.py::test_the_example_walks_by_the_elkapods_own_topic_and_joint_names",
    "ros2/test_rclpy.py::test_a_peer_that_is_killed_in_mid_walk_leaves_a_robot_that_stands_and_then_sits",
    "ros2/test_rclpy.py::test_nodes_that_come_and_go_ten_times_a_second_disturb_no_walk",
    "ros2/test_rclpy_action.py",
    "ros2/test_rclpy_node.py::test_one_that_others_manage_waits_for_them_and_publishes_no_joints_until_then",
    "ros2/test_rclpy_node.py::test_parameters_by_file_and_by_name_are_rates_frames_and_where_other_joints_are",
    "ros2/test_rclpy_node.py::test_a_parameter_that_cannot_be_is_a_sentence",
    "ros2/test_several_nodes.py::test_a_peer_that_is_killed_in_mid_walk_leaves_a_robot_that_stands_and_then_sits",
    "ros2/test_several_nodes.py::test_nodes_that_come_and_go_ten_times_a_second_disturb_no_walk",
    "console/test_power.py::test_an_event_of_the_board_is_bad_and_said_in_plain_words",
    "console/test_power.py::test_what_each_servo_draws_is_a_bar_and_the_strip_stays_on_the_picture",
    "ros2/test_rclpy.py::test_a_flood_keeps_no_emergency_stop_waiting_and_ros_leaves_its_own_alone",
)
"""What only `make test-all` runs: folders, files, tests, or tests with some of their parameters."""
APART: Final = ("hil", "fuzz", "zenoh/test_service.py")
"""Tests that share nothing with those beside them, so that each may run on whichever worker is free."""
TOGETHER: Final = ("box", "net", "ros2")
"""Folders that share a machine or a bridge; files of other folders share a gateway."""
SECOND_BOX: Final = ("box/test_upgrade.py", "box/test_check_faults.py", "box/test_pages.py")
"""These prepare a machine of their own, beside the other boxes: one after the other would take twice as long."""
SEARCHES: Final = ("fuzz/test_model_check.py",)
"""The model check: minutes of a processor, while the attended, and then those that run alone, leave one idle."""
SECONDS: Final = {
    "unit": 150,
    "hil": 140,
    "attack": 150,
    "zenoh": 330,
    "ros2": 120,
    "box": 130,
    "console": 170,
    "net": 80,
    "fuzz": 40,
}
"""Of each folder: the seconds that its tests may take in `make test`, added up over the workers."""
STAGES: Final = {"alone": ALONE, "attended": ATTENDED, "searches": SEARCHES}
"""By the mark that `make test` asks for: where its tests are."""


def arrange(items: list[pytest.Item]) -> None:
    """Sort the tests, and mark those that run alone."""
    for item in items:
        if is_extended(item.nodeid):
            item.add_marker(pytest.mark.extended)
        if _is_among(_file(item.nodeid), ALONE):
            item.add_marker(pytest.mark.alone)
        elif _is_among(_file(item.nodeid), ATTENDED):
            item.add_marker(pytest.mark.attended)
        elif _is_among(_file(item.nodeid), THOROUGH):
            item.add_marker(pytest.mark.thorough)

    def place(item: pytest.Item) -> int:
        folder = _file(item.nodeid).partition("/")[0]
        return ORDER.index(folder) if folder in ORDER else -1

    items.sort(key=place)


def is_extended(nodeid: str) -> bool:
    """Whether only `make test-all` runs this test; without parameters: whether it leaves all of the test to it."""
    of_tests = nodeid.removeprefix("tests/")
    return any(place in EXTENDED for place in (of_tests, of_tests.partition("[")[0])) or _is_among(
        _file(nodeid), EXTENDED
    )


def is_elsewhere(path: Path, marks: str) -> bool:
    """Whether a file has no test with these marks; to import it for the sake of its marks would take its time."""
    if path.suffix != ".py":
        return False
    file = str(path.relative_to(TESTS))
    stage = marks.partition(" ")[0]
    if stage in STAGES and not _is_among(file, STAGES[stage]):
        return True
    return "not extended" in marks and _is_among(file, EXTENDED)


def give_way(process: int) -> None:
    """Let it, and what it starts, leave the processors to whoever else wants one, at once: a nice value only gives them
    more of the time."""
    os.sched_setscheduler(process, os.SCHED_IDLE, os.sched_param(0))


def group(nodeid: str) -> str:
    """What runs on one worker, one after the other."""
    file = _file(nodeid)
    if _is_among(file, APART):
        return nodeid
    if _is_among(file, SECOND_BOX):
        return "the second box"
    return file.partition("/")[0] if _is_among(file, TOGETHER) else file


def _file(nodeid: str) -> str:
    """Its file, from the folder in tests/ on."""
    return nodeid.partition("::")[0].removeprefix("tests/")


def _is_among(file: str, places: Sequence[str]) -> bool:
    return file in places or file.partition("/")[0] in places
