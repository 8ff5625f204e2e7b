"""Faults of the reference code, W1 to W22, and the tests that keep each of them out of here.

They were seen in the public code of [Kim2019] and [Kim2020] (byungsook/neural-flow-style on
GitHub), most of them by running it on made smoke; ``tests/stability.py`` puts them into
docs/stability.md.
"""

__all__ = ["FAULTS"]

FAULT = "tests/numerics/test_reference_faults.py::"
EXTREMES = "tests/unit/core/test_stylize_extremes.py::"
STYLIZE = "tests/unit/core/test_stylize.py::"
WINDOW = "tests/unit/core/test_stylize_window.py::"
TRANSPORT = "tests/unit/core/test_transport.py::"
SAMPLE = "tests/unit/core/test_sample.py::"
OPTIMIZE = "tests/unit/core/test_optimize.py::"
OPTICS = "tests/unit/core/test_optics.py::"
SCENE = "tests/unit/core/test_scene.py::"
VIEWS = "tests/unit/core/test_views.py::"
WARM = "tests/unit/core/test_departures.py::"
IMAGES = "tests/unit/pictures/test_png.py::"
PROJECTION = "tests/numerics/test_projection.py::"

FAULTS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("W1: MacCormack's limiter takes its bounds from the middle of the domain, which undoes the "
     "correction nearly everywhere",
     "finite: no such correction; a cubic warp stays within the range of the field",
     (TRANSPORT + "test_result_is_finite_and_in_range_at_every_cfl_number",)),
    ("W2: density above 1 makes the unknown grow in every iteration",
     "finite: the mask stays within [0, 1], and denser smoke moves no farther",
     (FAULT + "test_density_above_one_is_moved_no_farther",
      "tests/unit/core/test_displacement.py::test_mask_does_not_depend_on_the_unit_of_density")),
    ("W3: one empty frame turns every frame into NaN",
     "finite: it stays empty and changes no bit of other frames",
     (FAULT + "test_an_empty_first_frame_changes_no_bit_of_the_frames_after_it",
      SCENE + "test_empty_frames_are_passed_over",
      WINDOW + "test_an_empty_frame_in_between_does_not_break_the_chain")),
    ("W4: one NaN voxel spoils the whole result silently",
     "named error NonFiniteError: count, grid and timeCode, for density and velocity",
     (STYLIZE + "test_density_that_is_not_finite_is_refused_by_time_code_and_name",
      STYLIZE + "test_velocity_that_is_not_finite_is_refused_by_time_code_and_name")),
    ("W5: huge velocities read border values, without sub-steps or a check",
     "finite: sub-steps follow the CFL number, and only the background flows in; "
     "named error PlanError: for absurd velocities",
     (TRANSPORT + "test_substeps_follow_the_fastest_component",
      TRANSPORT + "test_shift_by_whole_voxels_is_exact_and_brings_in_nothing",
      TRANSPORT + "test_absurd_velocity_is_refused_with_its_cfl_number")),
    ("W6: any learning rate is accepted, smoke leaves the domain, and the last state is returned",
     "finite: displacement is limited; a rate that is too large is halved, and the best "
     "state is returned",
     (FAULT + "test_no_learning_rate_moves_smoke_beyond_its_reach",
      OPTIMIZE + "test_a_learning_rate_a_hundred_times_too_large_is_found_reduced_and_reported",
      OPTIMIZE + "test_the_best_remembered_state_comes_back_when_the_end_is_clearly_worse")),
    ("W7: thick smoke underflows to a black picture and NaN; negative extinction is accepted",
     "finite: at any optical depth; named error ConfigError: extinction that is not above 0",
     (FAULT + "test_negative_extinction_is_refused", EXTREMES + "test_any_extinction",
      OPTICS + "test_any_optical_depth_gives_finite_values_and_gradients")),
    ("W8: negative density is clipped even where nothing changes",
     "finite: unchanged where no smoke is moved, treated as 0 elsewhere",
     (FAULT + "test_negative_density_comes_back_as_it_was_where_nothing_is_moved",
      EXTREMES + "test_negative_density_counts_as_none_where_smoke_is_moved")),
    ("W9: a rotation stretches smoke in a box that is not a cube",
     "finite: views are rigid in stage space, whatever the box",
     (FAULT + "test_a_quarter_turn_of_a_box_that_is_no_cube_is_rigid",
      TRANSPORT + "test_rotation_of_a_box_that_is_no_cube_is_rigid",
      VIEWS + "test_axes_are_orthonormal_with_one_handedness")),
    ("W10: smoke at the border of the box is smeared outwards when rotated or moved",
     "finite: outside the box is empty; mass is kept in each view",
     (FAULT + "test_a_sheet_on_the_floor_keeps_its_mass_in_every_view",
      FAULT + "test_room_around_smoke_that_touches_its_walls_changes_nothing",
      TRANSPORT + "test_smoke_that_leaves_the_box_leaves")),
    ("W11: steps are scaled by a mean over the whole box, so empty space enlarges them",
     "finite: empty space around the smoke changes nothing",
     (FAULT + "test_room_around_smoke_that_touches_its_walls_changes_nothing",
      STYLIZE + "test_emptiness_around_the_smoke_changes_nothing",
      SCENE + "test_emptiness_around_the_smoke_changes_nothing")),
    ("W12: the middle view is at a corner of the range, or outside",
     "finite: the pool contains the middle, and no view leaves its range",
     (VIEWS + "test_fixed_angles_start_with_the_middle_and_one_view_is_the_middle",
      VIEWS + "test_every_count_and_range_gives_that_many_angles_inside_the_range")),
    ("W13: views are truncated in order of creation, so all are on one side, or fewer than "
     "requested",
     "finite: the requested number, and each prefix of the list is spread out",
     (FAULT + "test_eight_views_all_round_leave_no_third_of_the_circle_unseen",
      VIEWS + "test_every_count_and_range_gives_that_many_angles_inside_the_range",
      VIEWS + "test_a_larger_poisson_set_starts_with_the_smaller_one",
      VIEWS + "test_poisson_angles_lie_farther_apart_than_random_ones")),
    ("W14: a range of one angle loops forever; many views, or a number that the batch does not "
     "divide, crash",
     "finite: every range and number of views is valid",
     (FAULT + "test_any_number_of_views_an_iteration_from_any_pool",
      VIEWS + "test_every_count_and_range_gives_that_many_angles_inside_the_range")),
    ("W15: mixtures of gradient and curl, many octaves, grey styles and frames of different size "
     "crash; a parameter file is identified by its name",
     "finite: all of these run; parameter files are identified by content",
     (FAULT + "test_any_number_of_octaves",
      FAULT + "test_frames_of_different_size_are_stylized_in_one_window",
      STYLIZE + "test_smoke_moves_less_than_its_reach_and_keeps_its_mass[mixed]",
      "tests/numerics/test_transport_gradients.py::"
      "test_mixture_with_both_parts_has_gradients_for_both",
      IMAGES + "test_every_colour_mode_becomes_rgb[L]", EXTREMES + "test_any_style_image[grey]",
      "tests/unit/core/test_vgg19.py::test_a_state_dict_gives_torchvision_s_features")),
    ("W16: blurs run across the components of the velocity, and across frames",
     "finite: channels and frames are independent",
     ("tests/unit/core/test_resample.py::test_blur_agrees_with_scipy_and_does_not_mix_channels",
      SAMPLE + "test_channels_are_sampled_as_if_alone",
      FAULT + "test_a_frame_depends_on_no_frame_after_it_but_those_it_is_averaged_with")),
    ("W17: a window averages frames twice, an even size is reduced by one, and losses are not "
     "recorded",
     "finite: each frame starts from the previous one and is averaged once with the following one, "
     "along the smoke's path; windows have the requested size; each iteration reports its loss",
     (FAULT + "test_a_frame_depends_on_no_frame_after_it_but_those_it_is_averaged_with",
      WARM + "test_the_sign_of_time_follows_the_neighbour",
      "tests/unit/planning/test_windows.py::test_without_gaps_all_but_the_last_window_are_full",
      WINDOW + "test_progress_counts_over_octaves_and_frames")),
    ("W18: rays have no step length: optical depth changes with octave and resolution",
     "finite: extinction has a length; half and double resolution give the same picture",
     (PROJECTION + "test_half_and_double_resolution_give_the_same_picture_at_equal_extinction",
      SCENE + "test_a_set_gamma_is_per_voxel_and_becomes_per_length")),
    ("W19: a velocity grid of another size is stretched over the density's silently",
     "finite: it is read at its position in space",
     (WARM + "test_velocity_is_read_in_its_own_grid_and_world",
      EXTREMES + "test_velocity_in_a_box_that_does_not_meet_the_smoke")),
    ("W20: particle densities are divided by sums of weights that can be 0; NaN gradients become "
     "0 silently",
     "finite: sums of weights are never 0; a step with a gradient that is not finite is rolled "
     "back",
     (OPTICS + "test_any_optical_depth_gives_finite_values_and_gradients",
      OPTICS + "test_emission_without_density_gives_no_light_and_no_gradient_trouble",
      "tests/unit/core/test_losses.py::test_an_empty_guide_gives_zeros_and_a_finite_gradient",
      "tests/unit/core/test_smoke.py::test_nothing_bleeds_in_from_outside_the_smoke",
      OPTIMIZE + "test_a_gradient_that_is_not_finite_is_rolled_back")),
    ("W21: a particle near a wall writes outside the grid",
     "finite: values outside the picture or box are left out, with their gradient",
     ("tests/unit/core/test_project.py::"
      "test_what_lies_outside_the_image_is_left_out_of_both_directions",
      SAMPLE + "test_far_outside_nothing_is_smeared_in",
      "tests/unit/core/test_smoke.py::"
      "test_colours_at_places_absurdly_far_away_are_none_and_finite")),
    ("W22: versions, views and losses are not kept with the result",
     "finite: versions, settings and seed are in the layer, and determine the views; "
     "the losses of each frame are in run.json",
     (FAULT + "test_the_record_gives_back_versions_settings_views_and_losses",
      "tests/unit/base/test_record_format.py::"
      "test_a_record_comes_back_from_its_text_with_every_bit")),
)  # fmt: skip
