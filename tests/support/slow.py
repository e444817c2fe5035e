"""Which tests take long.

`make unit-fast` leaves out `MODULES` and `TESTS`: each takes more than about a third of a second, or needs a fixture that
does.
"""

MODULES = frozenset(
    """
    bench bench_links campaign cli compiled conflict demonstrations distributed docs equation_audit every_backend exactness
    extras facts hierarchies holding import_graph interruption isolation jobs lifted long_windings metrics native_backends
    page_in_chromium paper paper_kinematics paper_solvers paper_windings qpbenchmark_set readme rendering rivals
    strict_winding survival torques tree_elimination tree_step viewer wind_own_robot witness
    """.split()
)

#: Modules that take more than about ten seconds, longest first: they are started in this order, before all others, so that
#: none runs alone at the end while other processes wait.
LONGEST = """
    paper readme docs interruption examples qpbenchmark_set jobs page_in_chromium compare_scenes metrics compiled
    hierarchies active_set comparison solve_step rendering viewer cli closed_form_map paper_windings scene exactness
    mink_dropin certificate native_backends strict_winding
    """.split()

TESTS = {
    "active_set": (
        "recorded_steps_are_found_again_to_the_same_bits_from_answers_off_by_a_millionth",
        "the_trace_names_the_rows_added_and_dropped_and_no_set_is_visited_twice",
        "wrong_guesses_take_corrections_and_right_ones_none",
        "from_a_guess_made_of_nothing_every_problem_is_solved",
    ),
    "any_input": ("a_solver_that_does_not_exist_is_told_with_those_that_do",),
    "batch": (
        "an_error_of_a_worker_is_raised_here",
        "over_processes_as_one_by_one_to_the_last_bit",
    ),
    "certificate": (
        "the_steps_of_a_winding_are_certified_from_problem_and_step_alone",
        "rounding_leaves_next_to_no_planted_optimum_undecided",
    ),
    "closed_form": ("eqs_12_and_14_equal_a_fifty_digit_solution_in_the_15_worst_of_200_poses",),
    "closed_form_map": (
        "the_closed_form_winds_a_straight_arm_from_every_direction",
        "the_figure_of_the_map_has_a_cell_a_winding_and_a_letter_a_failure",
        "the_map_counts_by_first_link_and_names_the_reasons",
        "with_eq_24_it_winds_one_link_further_than_with_eq_23",
        "with_more_than_a_turn_left_the_free_tail_is_in_the_object",
    ),
    "compare_scenes": (
        "a_solver_that_is_off_or_gives_no_answer_is_named_on_a_scene_too",
        "compare_takes_scenes_from_the_command_line_and_writes_its_report",
        "every_solver_replays_and_drives_a_scene_and_ends_where_it_was_recorded",
        "recordings_and_saved_problems_are_replayed_and_driven_by_nobody",
    ),
    "comparison": (
        "a_backend_that_crashes_hangs_or_eats_memory_fails_alone",
        "a_backend_that_crashes_while_it_drives_leaves_no_winding",
        "a_backend_that_is_off_by_a_hundred_thousandth_disagrees",
        "a_last_joint_off_on_one_step_in_a_hundred_is_named_whether_rows_bind_there_or_not",
        "a_plugin_brings_backends_of_ones_own_and_strict_names_the_one_that_fails",
        "a_process_lost_after_its_last_record_costs_nothing",
        "a_worker_that_runs_another_program_is_refused_by_its_host",
        "the_damped_formulation_is_another_problem",
    ),
    "compiled_look": (
        "a_core_that_sees_something_else_is_not_asked_again_and_says_so",
        "along_a_winding_the_two_forms_see_and_pose_the_same",
    ),
    "curvature": (
        "a_humanoid_on_a_random_walk_of_2000_steps_keeps_off_itself_and_the_ground",
        "our_own_humanoid_with_boxes_for_feet_does_too",
        "steps_of_first_order_do_not_keep_off",
    ),
    "episode": (
        "an_arm_in_contact_from_k_on_has_wound",
        "a_saved_episode_loads_bit_for_bit",
        "an_episode_of_an_unknown_solver_does_not_start",
        "the_problem_of_a_step_names_joints_and_links",
        "a_full_disk_keeps_the_old_file_and_leaves_nothing_behind",
        "saving_twice_replaces_the_file",
    ),
    "examples": ("an_example_runs_and_draws_its_picture",),
    "explain": ("a_winding_step_gives_way_to_named_bounds_and_contacts",),
    "failures": (
        "a_dead_sensor_leaves_a_gap_in_m_that_drives_several_arms",
        "hysteresis_keeps_contacts_that_noise_takes_away",
        "loose_contacts_come_and_go_alike_in_every_run",
        "with_c_reversed_an_arm_says_wound_that_is_folded_and_not_wound",
        "the_plan_follows_what_is_felt_and_not_what_touches",
    ),
    "invariance": (
        "a_factor_that_the_weights_do_not_make_up_for_gives_another_step",
        "joint_units_that_the_metric_does_not_make_up_for_give_another_step",
        "other_units_give_the_same_step_and_the_same_status",
    ),
    "lexicographic": (
        "steps_scale_with_the_time_step",
        "the_times_of_a_solve_are_inside_and_outside_the_backend_and_of_the_polish",
        "a_closed_form_that_meets_every_row_is_the_answer_bit_for_bit",
        "the_closed_form_is_no_answer_where_it_breaks_a_row",
        "weights_however_far_apart_are_nearly_two_levels_and_no_obstacle",
        "without_the_closed_form_first_the_solver_finds_the_same_step",
        "trying_the_closed_form_first_does_not_change_a_constrained_step",
        "a_closed_form_step_is_certified_without_a_solver",
        "a_polished_step_keeps_the_solvers_own",
    ),
    "live": ("it_winds_like_problems_made_anew",),
    "methods": (
        "a_method_that_lies_is_named_by_the_comparison_and_the_kernel_agrees",
        "a_pool_of_processes_takes_methods_and_hands_back_their_steps",
        "mink_steps_where_a_winding_posed_the_problem_and_nowhere_else",
    ),
    "mink_dropin": (
        "a_humanoid_keeps_its_feet_and_its_balance_with_hands_in_reach_and_far_out_of_it",
        "an_arm_drawn_out_of_reach_is_calm_and_comes_back",
        "an_unknown_solver_is_told_with_those_that_there_are",
        "at_the_default_damping_the_answer_is_that_of_sixty_digits",
        "importing_the_package_does_not_import_mink",
        "the_demonstration_shows_who_is_nearer_to_sixty_digits",
        "with_one_level_the_answer_is_the_optimum_of_minks_qp",
    ),
    "model_equalities": (
        "a_loop_that_is_turned_round_and_round_opens_by_no_more_than_a_tenth_of_the_accuracy",
        "everything_that_is_coupled_stays_so_while_a_robot_wanders",
        "steps_of_first_order_open_it_by_the_square_of_their_length",
    ),
    "notation": ("every_name_in_backticks_with_dots_exists",),
    "own_qps": (
        "a_qp_is_judged_by_the_residuals_of_its_problem",
        "own_episodes_and_qps_take_the_place_of_the_windings",
        "qps_alone_are_in_the_json_and_nothing_that_strict_could_check",
    ),
    "page": (
        "repeats_are_one_answer_and_its_time_the_median",
        "windings_beyond_the_budget_keep_every_few_states_and_the_last",
        "a_winding_without_a_file_is_not_replayed_but_told_among_the_failures",
    ),
    "posing_sabotage": ("its_honest_function_is_right", "what_is_wrong_is_noticed"),
    "pressing": (
        "a_link_40_mm_deep_comes_out_by_no_more_than_is_asked_of_a_step",
        "pressing_for_600_steps_a_link_comes_to_rest_at_the_surface",
        "without_push_out_it_stays_as_deep_as_its_curvature_took_it",
    ),
    "recording": ("a_recording_is_read_as_it_was_written_to_the_last_bit",),
    "robot_limits": (
        "a_joint_that_is_driven_to_its_stop_brakes_in_time_and_ends_on_it",
        "a_moving_arm_that_meets_an_object_stops_there_whatever_its_acceleration",
        "the_centre_of_mass_stays_above_the_feet_however_far_the_hands_are_drawn",
        "without_the_limit_it_leaves_them",
        "without_the_limit_the_same_joint_stops_at_once",
    ),
    "scene": (
        "a_scene_without_a_way_to_its_target_says_whether_reach_or_limits_are_short",
        "a_task_file_poses_the_problem_that_its_classes_pose_by_hand",
        "bad_input_is_one_clear_message_that_names_the_file",
        "every_solver_moves_the_robot_alike",
        "solve_writes_what_it_shows_and_ends_with_one_where_the_tasks_are_not_met",
        "the_example_scenes_run_and_end_as_their_first_line_says",
        "whatever_stands_at_a_key_the_file_loads_or_is_one_message",
    ),
    "slack": (
        "a_damping_too_weak_for_the_square_of_the_matrix_still_decides_in_the_slack_qp",
        "the_slack_qp_is_solved_once_with_default_options",
    ),
    "solve_step": (
        "a_humanoid_keeps_feet_and_balance_strictly_and_comes_to_rest",
        "a_robot_that_starts_40_mm_deep_comes_out",
        "an_arm_drawn_out_of_reach_and_back_is_calm_and_returns",
        "min_distance_is_kept_at_rest",
        "pressing_for_600_steps_goes_no_deeper_than_a_tenth_of_a_millimetre",
        "without_the_way_back_a_robot_that_starts_deep_stays_deep",
    ),
    "stages": (
        "on_recorded_steps_the_stages_cost_is_that_of_the_decomposed_jacobian",
        "standing_still_is_feasible_in_every_first_stage",
        "the_first_stages_variables_reach_every_joint_step",
    ),
    "subspaces": ("of_the_random_cones_some_hold_no_row_some_a_few_and_some_all",),
}
