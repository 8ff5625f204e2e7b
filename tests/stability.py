"""What happens with extreme input, and the tests that check it.

``python -m tests.stability`` writes docs/stability.md from this list;
``tests/repository/test_stability_table.py`` holds the two together.
"""

from dataclasses import dataclass
from pathlib import Path

from tests.reference_faults import FAULTS

__all__ = ["DOCUMENT", "ENTRIES", "NOT_YET_CHECKED", "REFERENCE", "Entry", "render_document"]

DOCUMENT = Path(__file__).parent.parent / "docs" / "stability.md"

EXTREMES = "tests/unit/core/test_stylize_extremes.py::"
STYLIZE = "tests/unit/core/test_stylize.py::"
SIGHT = "tests/unit/core/test_sight.py::"
OUTLIERS = "tests/unit/core/test_outliers.py::"
FAST = "tests/unit/core/test_fast_smoke.py::"
OPTIMIZE = "tests/unit/core/test_optimize.py::"
OPTICS = "tests/unit/core/test_optics.py::"
FEATURES = "tests/unit/core/test_features.py::"
IMAGES = "tests/unit/pictures/test_png.py::"
PROFILES = "tests/unit/pictures/test_profiles.py::"
READ = "tests/unit/vdb/test_read.py::"
VELOCITY = "tests/unit/vdb/test_velocity.py::"
REFUSED = (
    "tests/command/test_bad_input.py::test_bad_input_is_refused_by_name_and_leaves_nothing_behind"
)
STAGES = "tests/runs/test_extreme_stages.py::"
MASK = "tests/unit/planning/test_mask.py::"
MASK_FIELD = "tests/unit/core/test_mask_field.py::"
WARM = "tests/unit/core/test_departures.py::"
WINDOWS = "tests/unit/planning/test_windows.py::"


@dataclass(frozen=True)
class Entry:
    """One kind of input.

    Attributes:
        group: heading of the document.
        what: the input.
        happens: "finite: ..." or "named error X: ...", or both, joined by a semicolon.
        tests: path::function, with [case] where the case's name stands in that file.
    """

    group: str
    what: str
    happens: str
    tests: tuple[str, ...]


def _group(name: str, *rows: tuple[str, str, tuple[str, ...]]) -> tuple[Entry, ...]:
    return tuple(Entry(name, what, happens, tests) for what, happens, tests in rows)


VOLUME = _group(
    "Volume",
    ("empty frame", "finite: an empty frame is written; renderer and network are not called",
     ("tests/command/test_bad_input.py::test_an_empty_frame_becomes_an_empty_frame",
      STYLIZE + "test_an_empty_frame_is_passed_through_without_renderer_or_network")),
    ("empty frame in the middle of a shot", "finite: the frames around it still follow each other",
     ("tests/unit/core/test_stylize_window.py::"
      "test_an_empty_frame_in_between_does_not_break_the_chain",)),
    ("one voxel, a row of them", "finite: the mass is kept",
     (EXTREMES + "test_few_voxels_in_any_arrangement",)),
    ("two voxels 10⁶ apart", "finite: the colour step paints both; named error PlanError: the "
     "shape step cannot move them, and the message says how to leave it out",
     (EXTREMES + "test_two_voxels_a_million_apart_are_painted",
      EXTREMES + "test_two_voxels_a_million_apart_are_not_moved_but_refused_by_name")),
    ("a box that does not fit in memory", "named error GridTooLarge: with its size and the limit",
     (READ + "test_box_that_does_not_fit_is_refused_with_the_number",
      REFUSED + "[too little for a grid]")),
    ("slab one voxel thick", "finite: stays one voxel thick and is seen from one side",
     (STYLIZE + "test_a_slab_stays_one_voxel_thick_and_is_seen_from_one_side",)),
    ("negative density", "finite: treated as 0 where smoke is moved",
     (EXTREMES + "test_negative_density_counts_as_none_where_smoke_is_moved",)),
    ("density in inactive voxels", "finite: in the box of the active ones it counts as smoke; a "
     "warning tells what is within 8 voxels outside",
     (EXTREMES + "test_densities_of_inactive_voxels_beside_the_box_are_told",
      "tests/unit/vdb/test_read.py::test_inactive_voxels_beside_the_box_are_told")),
    ("NaN, infinite density", "named error NonFiniteError: with number, place, file, field and "
     "timeCode; with `--repair nan=...` finite: replaced by that number",
     (READ + "test_nan_and_infinite_voxels_are_counted_and_placed", REFUSED + "[NaN]",
      STYLIZE + "test_density_that_is_not_finite_is_refused_by_time_code_and_name",
      "tests/command/test_bad_input.py::test_repair_accepts_nan_and_puts_the_number_there")),
    ("denormal density", "finite: treated as 0",
     (EXTREMES + "test_denormal_density_counts_as_none",)),
    ("density of 1e-30 and 1e30", "finite: looks and is moved like ordinary smoke",
     (EXTREMES + "test_density_of_any_amount_looks_the_same",
      EXTREMES + "test_density_of_any_amount_is_moved_like_ordinary_smoke")),
    ("density over sixty orders of magnitude in one frame", "finite: the mass is kept",
     (EXTREMES + "test_density_over_sixty_orders_of_magnitude",
      EXTREMES + "test_no_voxel_is_lost_behind_the_curve_that_thickens")),
    ("one voxel 10² … 10³⁰ times denser than the rest", "finite: smoke around it moves, is seen "
     "and is kept as ever",
     (OUTLIERS + "test_smoke_around_one_dense_voxel_moves_and_is_painted_as_ever",
      OUTLIERS + "test_one_dense_voxel_deletes_no_smoke_and_the_mass_of_both_is_kept")),
    ("one voxel far away from the smoke", "finite: the smoke is moved by a share of its own size",
     (OUTLIERS + "test_one_voxel_far_away_moves_no_smoke_out_of_its_place",)),
    ("remains far away, up to 5 % of the smoke", "finite: opacity and motion are those of the "
     "smoke alone; a finding names coarser pictures",
     (OUTLIERS + "test_remains_far_away_change_neither_extinction_nor_reach",
      "tests/unit/runs/test_light_findings.py::"
      "test_voxels_far_away_that_make_pictures_coarse_are_named")),
    ("a floor of thin density in all of the box", "finite: gamma and motion are those of the smoke "
     "above it",
     (OUTLIERS + "test_a_floor_in_all_of_the_box_changes_neither_extinction_nor_reach",)),
    ("thin smoke of any shape around a dense puff", "finite: a finding names it",
     (OUTLIERS + "test_thin_smoke_that_covers_the_picture_and_is_chosen_is_measured",)),
    ("dense smoke apart from thin fog that has more voxels", "finite: gamma is within four times "
     "that of the dense smoke alone",
     (OUTLIERS + "test_dense_smoke_apart_from_more_thin_smoke_is_no_remains",)),
    ("parts of one Volume far apart", "finite: gamma is that of one part; a finding names them",
     (OUTLIERS + "test_lumps_far_apart_have_the_extinction_of_one_and_are_named",)),
    ("a mask that slides over resting smoke", "finite: the temporal error compares what both masks "
     "select",
     ("tests/unit/core/test_mask_effect.py::"
      "test_a_mask_that_slides_over_resting_smoke_is_no_flicker",)),
    ("a camera inside the smoke", "finite: it sees colours, and plan and finding warn that strokes "
     "do not fit into its picture",
     (SIGHT + "test_a_camera_in_the_smoke_sees_colours_and_the_report_tells_how_close_it_is",
      "tests/unit/runs/test_camera_runs.py::test_the_plan_names_frames_whose_camera_stands_in_the_smoke")),
    ("a near clipping plane that cuts the smoke, or hides all of it", "finite: what is cut off "
     "stays as in the source, and a finding tells how much",
     (SIGHT + "test_smoke_before_the_near_clipping_plane_is_counted",
      SIGHT + "test_a_frame_beyond_the_clipping_planes_is_left_out_and_says_so")),
    ("smoke ten times as long as wide", "finite: a finding names its opacity from all sides",
     ("tests/unit/core/test_frame_errors.py::"
      "test_smoke_that_is_long_in_one_direction_has_other_depths_from_its_sides",)),
    ("a mask that selects no smoke", "finite: the source, with a finding",
     ("tests/unit/runs/test_findings.py::test_a_shot_of_which_nothing_is_stylized_says_so",)),
    ("sheets and filaments of one or two voxels, porous smoke", "finite: moved like thick smoke",
     ("tests/unit/core/test_thin_smoke.py::test_thin_smoke_is_moved",)),
    ("background other than 0", "finite: fills only the box of the active voxels",
     (EXTREMES + "test_a_background_other_than_zero_fills_the_box_only",
      READ + "test_active_tile_is_filled_and_background_shows_between")),
    ("background NaN or infinite", "named error NonFiniteError: names the background",
     (READ + "test_background_that_is_not_finite_is_refused",)),
    ("active tiles", "finite: filled with their value",
     (READ + "test_active_tile_is_filled_and_background_shows_between",)),
    ("level set instead of fog", "named error UnsupportedGrid: field, timeCode, the class found",
     (REFUSED + "[level set]", READ + "test_grid_that_is_no_smoke_is_refused_from_its_header")),
    ("points instead of fog", "named error UnsupportedGrid: detected in the file's header",
     (READ + "test_grid_that_is_no_smoke_is_refused_from_its_header",
      "tests/unit/vdb/test_header.py::test_type_is_taken_apart")),
    ("types that the bindings lack, beside density", "finite: density is read, the others are "
     "ignored; named error UnsupportedGrid: if one of them is requested",
     (READ + "test_grids_of_other_types_in_the_file_are_left_alone", REFUSED + "[whole numbers]")),
    ("several grids of one name", "finite: selected by index; named error GridNotFound: for a "
     "higher index, with a list of the grids",
     (READ + "test_grid_is_found_by_name_then_index",
      READ + "test_grid_not_found_lists_what_the_file_has")),
    ("a missing mask", "named error GridNotFound: with a list of the fields and grids; "
     "named error AssetNotResolved: if its file or its timeCode is missing",
     (MASK + "test_a_mask_in_neither_place_is_refused_with_what_there_is",
      MASK + "test_a_missing_mask_file_and_a_gap_are_refused_with_their_timecode")),
    ("a mask of vectors, booleans or a level set, or scaled to size 0",
     "named error UnsupportedGrid: detected from stage and header",
     (MASK + "test_a_grid_that_is_no_field_of_numbers_is_no_mask",
      MASK + "test_a_mask_that_is_scaled_to_nothing_is_refused")),
    ("a mask or a velocity of one plane of voxels, or of one voxel",
     "finite: it acts where it lies; a velocity also on any slab of smoke",
     (MASK_FIELD + "test_a_flat_mask_holds_for_half_a_voxel_and_ends_after_a_whole_one",
      WARM + "test_a_velocity_of_one_plane_moves_the_smoke_in_it_and_any_slab")),
    ("NaN in a mask", "named error NonFiniteError: field and timeCode; finite: with "
     "`grids.repair_nan`",
     (MASK + "test_nan_in_a_mask_is_refused_or_repaired_as_in_a_density",)),
)  # fmt: skip

OPTICAL = _group(
    "Optics",
    ("optical depth 1e-12 … 1e6 across one voxel and across the volume",
     "finite: picture, values and gradients; the extinction bounds the light",
     (OPTICS + "test_any_optical_depth_gives_finite_values_and_gradients",
      EXTREMES + "test_any_extinction")),
    ("gamma 0", "named error ConfigError: as a setting; finite: in a scene built in code, "
     "without light and motion",
     (STAGES + "test_no_extinction_is_refused_as_a_setting",
      EXTREMES + "test_no_extinction_gives_no_light_and_no_motion_but_a_finite_result")),
    ("emission in voxels of zero density", "finite: no light, no gradient",
     (OPTICS + "test_emission_without_density_gives_no_light_and_no_gradient_trouble",)),
)  # fmt: skip

TRANSPORT = _group(
    "Transport",
    ("CFL number 0 … 50", "finite: in range, mass kept",
     (EXTREMES + "test_velocities_up_to_fifty_voxels_a_frame",
      WARM + "test_any_speed_gives_finite_colours_in_range")),
    ("smoke that comes from where there was none", "finite: the frame starts anew, with a warning",
     (FAST + "test_a_frame_whose_smoke_comes_from_nowhere_starts_anew_and_warns",)),
    ("velocity of the wrong sign, axis or unit, also of slow smoke",
     "finite: a warning says with which velocity the densities agree better",
     (FAST + "test_a_velocity_that_does_not_explain_the_smoke_is_named",
      FAST + "test_a_wrong_velocity_of_slow_smoke_is_named")),
    ("velocity that is 0 or too slow everywhere, or an empty grid, and smoke that moves",
     "finite: a warning, if the smoke moves by half a voxel; none if it fades or flickers",
     (FAST + "test_a_velocity_that_is_too_slow_for_its_smoke_is_named",
      FAST + "test_an_empty_velocity_grid_is_a_velocity_of_0",
      FAST + "test_smoke_that_changes_where_it_is_rests")),
    ("velocity that is 0 in a part of the smoke that moves on, as after pruning",
     "finite: a finding names the part and the remedy",
     (FAST + "test_a_velocity_that_ends_within_the_smoke_is_named",)),
    ("velocity whose time samples stand elsewhere than the density's",
     "finite: the plan names the timeCode whose velocity USD shows",
     ("tests/unit/usd/test_stage.py::test_a_velocity_with_other_samples_is_held",)),
    ("a velocity of a thousand voxels a frame or more, also of one voxel",
     "finite: the frame starts anew, and a finding names its speed",
     (FAST + "test_a_velocity_that_is_too_fast_to_be_followed_is_told_with_its_voxels",)),
    ("absurd velocity passed to the look-up of Python code",
     "named error PlanError: asks for the velocity's unit",
     (WARM + "test_an_absurd_velocity_is_a_named_error",)),
    ("NaN, infinite velocity", "named error NonFiniteError: grid and timeCode",
     (STYLIZE + "test_velocity_that_is_not_finite_is_refused_by_time_code_and_name",)),
    ("a Volume that grows and turns between frames", "finite: its pattern is no unsteadiness",
     ("tests/unit/core/test_steadiness.py::test_vectors_turn_and_grow_with_their_volume",)),
    ("density that blinks by a factor", "finite: the frame starts anew, and a warning tells by how "
     "many times", (FAST + "test_a_density_that_blinks_is_told_from_a_jump",)),
    ("velocity missing on some frames", "finite: colours stay in place there",
     (EXTREMES + "test_velocity_on_some_frames_only",
      WARM + "test_without_velocity_colours_stay_in_place")),
    ("staggered velocity", "finite: averaged to the voxel centres",
     (VELOCITY + "test_staggered_components_are_averaged_to_the_centres",)),
    ("velocity of another transform", "finite: read in its own grid and world",
     (WARM + "test_velocity_is_read_in_its_own_grid_and_world",)),
    ("velocity in another box", "finite: the mass is kept",
     (EXTREMES + "test_velocity_in_a_box_that_does_not_meet_the_smoke",)),
    ("velocity components on different voxels", "named error UnsupportedGrid: their "
     "transforms differ",
     (VELOCITY + "test_components_on_different_voxels_are_refused",)),
)  # fmt: skip

TRANSFORMS = _group(
    "Transforms",
    ("anisotropic voxels, up to 1 : 1000", "finite: the mass is kept, pictures have no holes",
     (EXTREMES + "test_voxels_a_thousand_times_longer_than_wide",
      "tests/numerics/test_footprints.py::"
      "test_constant_smoke_has_no_holes_and_hardly_ripples")),
    ("rotated, sheared and mirrored maps", "finite: transform and mass are kept",
     (STYLIZE + "test_turned_sheared_and_mirrored_grids_keep_their_transform",)),
    ("voxels of 2⁻²⁰ and 2²⁰ units", "finite: the same bits",
     (EXTREMES + "test_stages_in_microns_and_in_megametres_have_the_same_bits",)),
    ("smoke 10⁶ units from the origin", "finite: the same smoke",
     (EXTREMES + "test_smoke_a_million_units_from_the_origin",)),
    ("smoke 10¹³ voxels from the origin", "finite: a remark tells what places are rounded to",
     ("tests/unit/planning/test_remarks.py::test_a_place_that_doubles_cannot_hold_is_told",)),
    ("a perspective in a prim's transform, an upAxis of X", "named error StageError: names it",
     ("tests/unit/usd/test_places.py::test_a_perspective_is_refused_and_a_shear_is_not",
      "tests/unit/usd/test_stage_refusals.py::"
      "test_an_up_axis_that_no_view_turns_around_is_refused")),
    ("voxels of 10¹⁸ units", "finite: a remark tells their size",
     ("tests/unit/planning/test_remarks.py::test_voxels_beyond_single_precision_are_told",)),
    ("several grids of one name in a file", "finite: the first is read, and a remark says so",
     ("tests/unit/planning/test_remarks.py::"
      "test_a_choice_among_grids_of_one_name_is_told_until_the_stage_makes_it",)),
    ("a transform that changes from frame to frame",
     "finite: smoke that stands still in space keeps its colours",
     (EXTREMES + "test_a_grid_that_changes_place_and_voxel_size_from_frame_to_frame",)),
    ("transforms on the prims of field and Volume",
     "finite: the same smoke as with the grid's own transform; may change with time",
     (EXTREMES + "test_the_field_prim_s_place_counts_like_the_grid_s_own",
      "tests/unit/usd/test_stage.py::test_field_to_stage_is_the_field_prims_own_place_at_each_time")),
    ("metersPerUnit 0.01 and 1000", "finite: kept on the result, no effect on the smoke",
     (STAGES + "test_the_stage_s_unit_is_kept_and_changes_no_bit_of_the_smoke",)),
    ("Y-up and Z-up", "finite: views turn around the stage's axis",
     (EXTREMES + "test_smoke_is_stylized_with_either_axis_up",
      "tests/unit/core/test_views.py::test_conventions_of_both_up_axes_at_zero")),
)  # fmt: skip

TIME = _group(
    "Time",
    ("window longer than the shot", "finite: one window of all frames",
     (STAGES + "test_a_window_longer_than_the_shot_holds_all_of_it",)),
    ("gaps between frames", "finite: no window crosses a cut; smaller gaps are crossed",
     (WINDOWS + "test_no_window_reaches_over_a_cut", EXTREMES + "test_any_time_codes")),
    ("sub-frames, frame 0, negative frames", "finite: each timeCode has its own file",
     (STAGES + "test_negative_fractional_and_distant_timecodes_show_files_of_their_own",
      EXTREMES + "test_any_time_codes")),
    ("one frame", "finite: stylized on its own", (EXTREMES + "test_any_time_codes",)),
    ("timeCodes that do not ascend", "named error ShapeError: must be ascending",
     (WINDOWS + "test_time_codes_that_do_not_rise_are_refused",)),
)  # fmt: skip

STYLE_IMAGE = _group(
    "Style image",
    ("1 x 1", "finite: an image like any other",
     (IMAGES + "test_single_pixels_and_plain_colours_are_images_too",
      EXTREMES + "test_any_style_image[one pixel]")),
    ("smaller than the network's minimum", "finite: loss and gradients with the embedded "
     "network; VGG-19's poolings take a single pixel",
     (FEATURES + "test_strange_styles_give_finite_losses_gradients_and_no_loss_for_themselves",
      "tests/unit/core/test_vgg19.py::test_pictures_of_one_pixel_pass_all_poolings")),
    ("grey, palette, CMYK", "finite: becomes RGB",
     (*(IMAGES + f"test_every_colour_mode_becomes_rgb[{mode}]" for mode in ("L", "P", "CMYK")),
      IMAGES + "test_palette_gives_its_colours", EXTREMES + "test_any_style_image[grey]")),
    ("alpha", "finite: transparent pixels take the mean of the visible ones; named error "
     "ImageError: if fully transparent",
     (IMAGES + "test_transparent_pixels_take_the_mean_of_the_visible_ones",
      IMAGES + "test_fully_transparent_image_is_refused")),
    ("one colour", "finite: the plan says that there are no strokes",
     (IMAGES + "test_a_style_of_one_colour_is_noted",)),
    ("nearly black", "finite: the plan says so", (IMAGES + "test_a_nearly_black_style_is_noted",)),
    ("embedded colour profile", "finite: converted to sRGB; a note if it is damaged",
     (PROFILES + "test_a_profile_with_other_primaries_turns_the_colours",
      PROFILES + "test_a_damaged_profile_is_noted")),
    ("16-bit", "finite: scaled, not clipped",
     (IMAGES + "test_sixteen_bit_grey_keeps_its_precision",
      IMAGES + "test_sixteen_bit_colour_is_scaled_not_cut_off")),
    ("EXR with HDR values", "finite: clipped to [0, 1] and encoded",
     (IMAGES + "test_exr_is_linear_light_that_gets_clipped_and_encoded",)),
    ("linear image (EXR, float TIFF) that is brighter than 1 nearly everywhere",
     "named error ImageError: it would be plain white",
     (IMAGES + "test_linear_images_that_would_be_plain_white_are_refused",)),
    ("EXR with NaN pixels", "named error ImageError: with their number",
     (IMAGES + "test_nan_pixels_are_counted",)),
    ("one colour, no variance", "finite: loss and gradients",
     (EXTREMES + "test_any_style_image[one colour]",
      FEATURES + "test_strange_styles_give_finite_losses_gradients_and_no_loss_for_themselves")),
)  # fmt: skip

OPTIMISER = _group(
    "Optimiser",
    ("zero gradient at the start", "finite: nothing moves, nothing is rolled back",
     (OPTIMIZE + "test_a_zero_gradient_at_the_start_moves_nothing_and_is_no_error",)),
    ("loss weight 0", "finite: the source is returned, and the report says why",
     (STYLIZE + "test_no_strength_or_no_style_gives_the_source_back_and_asks_for_no_features",)),
    ("loss weight 1e12", "finite: the mass is kept",
     (EXTREMES + "test_loss_weights_of_any_size",)),
    ("learning rate 100 times too large", "finite: detected, rolled back, halved and reported; the "
     "end is no worse than the start",
     (OPTIMIZE + "test_a_learning_rate_a_hundred_times_too_large_is_found_reduced_and_reported",
      EXTREMES + "test_a_learning_rate_a_hundred_times_too_large_ends_no_worse_than_it_began")),
    ("learning rate 50 times too small", "finite: the optimiser's error is left out, and a finding "
     "names the rate",
     ("tests/runs/test_findings_of_runs.py::test_extreme_settings_have_their_verdicts",)),
    ("an objective that always diverges", "named error NonFiniteError: with the number of halvings",
     (OPTIMIZE + "test_a_hopeless_objective_is_a_named_error_that_counts_the_halvings",
      EXTREMES + "test_features_that_overflow_are_a_named_error")),
    ("Gram sums beyond 65504 in half precision", "finite: summed in single precision",
     ("tests/unit/core/test_losses.py::test_half_precision_sums_beyond_65504_stay_finite",)),
)  # fmt: skip

REPEATABILITY = _group(
    "Repeatability",
    ("the same seed twice on one machine", "finite: the same bits",
     (STYLIZE + "test_the_same_run_gives_the_same_bits",)),
    ("1 and 3 threads", "finite: the same bits",
     (STYLIZE + "test_three_threads_give_the_same_bits_as_one",)),
)  # fmt: skip

REFERENCE = _group("Faults of the reference code", *FAULTS)

ENTRIES = (
    *VOLUME, *OPTICAL, *TRANSPORT, *TRANSFORMS, *TIME, *STYLE_IMAGE, *OPTIMISER, *REPEATABILITY,
    *REFERENCE,
)  # fmt: skip

NOT_YET_CHECKED: tuple[str, ...] = ()

INTRODUCTION = """# Extreme input

Each case ends in one of two ways, and some in either, depending on the settings:

- *finite*: the run succeeds, and its result has no NaN or infinity. What the result is follows the
  colon.
- *named error*: the run stops before it writes a result. The class of the error and what its
  message says follow.

This file is written by `python -m tests.stability` from the list of tests, and
`tests/repository/test_stability_table.py` compares the two.
"""

FAULTS_FOUND = """\
W1 to W22 were found in the public code of [Kim2019] and [Kim2020] (byungsook/neural-flow-style),
most of them by running it. The second column says what usdsmoke does in the same case or the
closest one.
"""


def render_document() -> str:
    """The whole of docs/stability.md."""
    lines = [INTRODUCTION]
    for group in dict.fromkeys(entry.group for entry in ENTRIES):
        found = group == REFERENCE[0].group
        lines += [f"## {group}\n", *([FAULTS_FOUND] if found else [])]
        header = "fault there | what happens here" if found else "input | what happens"
        lines += [f"| {header} | checked by |", "| --- | --- | --- |"]
        for entry in (entry for entry in ENTRIES if entry.group == group):
            tests = "<br>".join(f"`{test}`" for test in entry.tests)
            lines.append(f"| {entry.what} | {entry.happens} | {tests} |")
        lines.append("")
    if NOT_YET_CHECKED:
        lines += ["## Not yet checked\n", *(f"- {what}" for what in NOT_YET_CHECKED), ""]
    return "\n".join(lines)


if __name__ == "__main__":
    DOCUMENT.write_text(render_document(), encoding="utf-8")
