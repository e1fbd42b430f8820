"""What all tests share: one thread to a process, the longest test first, and which tests the fast subset leaves out."""

from __future__ import annotations

import os

import pytest

# Workers share the cores (`pytest -n auto`), and so do the processes that tests start: none takes more than one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

#: What `pytest -m fast` leaves out: files, or tests in them, that take seconds (training, tuning, estimation, stiff
#: reference solutions, processes that start anew).
LONG = (
    "test_agents_tools.py",
    "test_balances.py",
    "test_benchmark.py",
    "test_blind_trials.py",
    "test_cli.py::test_a_reader_that_leaves_takes_no_results_with_it",
    "test_cli.py::test_a_command_that_is_told_to_end_leaves_nothing",
    "test_cli.py::test_hide_writes_logs_and_truth",
    "test_close_loop.py",
    "test_demo.py",
    "test_diagnosis_uncertainty.py",
    "test_diagnosis_dynamic_rig.py::test_the_fits_numbers_are_near_those_of_the_proof",
    "test_diagnosis_form_correction.py",
    "test_diagnosis_lines.py",
    "test_diagnosis_early_window.py",
    "test_diagnosis_local_minima.py",
    "test_diagnosis_rattling.py",
    "test_diagnosis_report.py",
    "test_diagnosis_robust.py",
    "test_diagnosis_row_times.py",
    "test_diagnosis_workflow.py",
    "test_effects.py::test_behind_a_gap_the_load_waits_until_the_gap_is_closed",
    "test_effects.py::test_relief_valves_open_higher_than_they_reseat_and_in_their_own_time",
    "test_engine.py",
    "test_form_corrections.py::test_the_second_bristle_takes_over_what_the_first_one_had_more",
    "test_hide.py",
    "test_jobs.py",
    "test_jit.py::test_a_user_without_a_home_can_use_it",
    "test_losses.py",
    "test_measured_command.py",
    "test_measured_csv.py::test_both_readers_give_the_same",
    "test_next_experiment.py",
    "test_notebooks.py::test_it_runs_small",
    "test_oracle.py",
    "test_page.py",
    "test_plant.py::test_every_parameter_of_every_effect_is_seen_in_some_signal",
    "test_plant.py::test_a_third_of_the_tolerance_moves_nothing_visible",
    "test_plant.py::test_the_error_falls_with_the_tolerance_for_every_effect",
    "test_plant_accuracy.py",
    "test_policy.py::test_shipped_policies_drive_as_when_they_were_scored",
    "test_probing.py",
    "test_recurrent.py",
    "test_reference.py",
    "test_reproduce.py",
    "test_speed.py::test_speed_writes_rates_and_the_error_at_that_speed",
    "test_style.py::test_checker[mypy]",
    "test_sweep.py",
    "test_training.py",
    "test_user_files.py",
    "test_valve_bench.py",
    "test_export_controllers.py",
    "test_fmu.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the fast tests, and begins with the type checker: at the end one worker would run it while others wait."""
    for item in items:
        file, _, test = item.nodeid.partition("::")  # parameters may have slashes in them
        if not f"{file.rpartition('/')[2]}::{test}".startswith(LONG) and not item.get_closest_marker("slow"):
            item.add_marker("fast")
    items.sort(key=lambda item: "test_checker[mypy]" not in item.nodeid)
