"""Reads a YAML file as a tree of settings; a mistake in it becomes an error of one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from mqslam.errors import ConfigError, suggest, untrusted

M = TypeVar("M", bound=BaseModel)
# The settings of former versions that are constants now, by sections.
_GONE = {
    "reading": (
        "usual_turn_s turns_around longest_step short_share rate_cell most_rates whole_turn cost_late "
        "cost_early cost_rate_change compared_azimuths compared_apart same_turn least_jitter_s "
        "smoothest_ratio roughest_ratio equal_likelihood most_turn_change stray_spreads most_late_s "
        "scans_around_break break_spreads break_lasts fewest_rows validity_share chirp_share lidar_clip_share "
        "lidar_clip_count lidar_clip_m lidar_same_m lidar_same_rad lidar_same_track_m lidar_same_track_rad "
        "lidar_longest_sweep alike fewest_azimuths track_slack_s"
    ),
    "sensor": "doppler_gain doppler_least doppler_stretches doppler_scans doppler_step doppler_steps",
    "detector": (
        "join_bins ring_contrast ring_cells saturation_bins noise_azimuths fixed_range_m fixed_sectors "
        "fixed_share fixed_most most_unread fixed_scans strongest smoothing_m "
        "join_m saturation ring_share"
    ),
    "chirps": (
        "background_m step_mps window_mps outlier_spreads doppler_beta min_range_m max_range_m cell_m smoothing_m "
        "contrast fastest_mps clear acceleration sectors fewest_azimuths"
    ),
    "psi": "alpha_s xi",
    "estimator": (
        "stabiliser basins difference_step unknown_speed unknown_yaw_rate search_blur search_extent shrink "
        "aspect_rad distinct_sigmas c c_start steps beta_t xi apart_share apart_blur correlation observed_share "
        "rival different search_pixel search_same search_peaks"
    ),
    "tracker": (
        "keyframe_rad sigma_position_m sigma_yaw sigma_vy persistence omega_max lost_share foresight_share "
        "least_matched least_share usual_memory beside_turn beside_turns start_speeds start_yaw_step "
        "rest_speed rest_slip rest_omega steady_s steady_turns search_sigmas search_least_m search_least_rad "
        "search_most_m search_most_rad grown_keyframes young_least unsteady_scans unsteady_least sigma_vx "
        "sigma_ax longest_coast_s young_scans foresight_scans held_scans keyframe_m keyframes speed_min sigma_scale "
        "final_width start_omega start_alpha matching_steps settled first_step foresight_margin fewest_returns "
        "least_sector doubtful_psi start_scans patience warm_up_scans shared_scans"
    ),
    "calibration": "trusted gross moved_m shared",
    "kiss_icp": (
        "fewest_matched surface_points flattest start_returns start_step_m start_as_good coast_vy coast_omega "
        "gap_turns coast_vx start_scans longest_coast_s backward_scans backward_every backward_warm_up"
    ),
    "open3d_icp": (
        "fewest_matched surface_points flattest start_returns start_step_m start_as_good coast_vy coast_omega "
        "gap_turns keyframe_rad first_reach scan_voxel coast_vx start_scans longest_coast_s backward_scans "
        "backward_every backward_warm_up reach_m keyframes keyframe_m iterations loss"
    ),
    "odometry": ("sigma_mount_m sigma_mount_rad mount_known_m mount_known_rad sigma_rest_m mount_common_m mount_common_rad"),
    "gyroscope": (
        "longest_delay_s least_correlation largest_scale usual_delay_s far_correlation most_wild told_sigmas "
        "delay_tolerance_s scale_tolerance largest_scale_sigma likely_scale knot_s first_walk sigma_bias fewest "
        "sigma_scale"
    ),
    "gnss": (
        "longest_delay_s most_jumps alike_s knot_s largest_walk_m largest_share antenna_apart least_spread fewest reach"
    ),
    "velocity": "largest_scale most_wild told_sigmas scale_tolerance sigma_bias_mps span_s fewest sigma_scale",
    "graph": (
        "drift_submaps drift_trusted drift_gross odometry_bias_walk submap_m common_drift_m common_drift_rad huber "
        "odometry_span_s odometry_fewest prior_m prior_rad lifted_m lifted_rad"
    ),
    "recognition": (
        "aside_step_m gap_m agree_m agree_rad agree_share spacing_m submap_m range_m rings sectors aside_m guesses "
        "search_m search_rad row"
    ),
    "loops": (
        "later_share tried_factor beyond_m beyond_rad spacing_m least_path_m reach_m search_m search_rad gate_m "
        "gate_rad submap_m fewest matched rival rounds passes sigmas probability sure_m kept floor_m floor_rad cauchy"
    ),
    "refinement": "reach_m spacing_m sample_m aside_m settled",
    "audit": (
        "later_share tried_factor beyond_m beyond_rad claimed_m rival_sigmas revisit_fewest span_fewest "
        "span_torn_m lever_turn_rad sampled_windows coverage_slack few_stamps cloud_sweep_s narrow_start "
        "narrow_reach speed_error_mps speed_fewest jump_mps2 jump_radps2 jump_factor jump_quantile "
        "least_overlap_kept difference_step unobserved fewest_neighbours hit_log_odds miss_log_odds "
        "log_odds_limit lever_turns span_least_m rival window probability step_scans step_every span_m step_fewest "
        "step_doubtful span_every_m step"
    ),
    "merge": (
        "near_m object_m margin_m fewest rival rounds moved_m sure_m cell_m also seen looks chance reach_m rays "
        "aspects cells"
    ),
    "map": "well_seen stop_s travel_m travel_rad keyframe_m",
    "localisation": (
        "aside_rad give_up_m confirmed renew_m reach_m matched aside_m sigmas block sample_m apart_m fewest usual_scale"
    ),
    "verdict": (
        "revisits_warn revisits_fail lever_warn lost_fail degenerate_warn uncovered_warn apart_fail scale_warn "
        "confidence power windows_warn windows_fail turn_warn delay_warn matched part_warn worse wrong_scale"
    ),
    "mend": "rounds",
    "compare": "places_apart lever_m places",
    "check": (
        "unsteady span_share late_share hole_steps unmeasured_share order_chance order_gain least_turn "
        "yaw_rate_floor largest_shift shift_error shift_ok fewest_steps least_speed explained stretches stretch_scans "
        "doubled fewest_turns keyframe_m mirrored shifts wrong_scale"
    ),
}
_NAMED = 5  # so many gone settings are named in an error


def parse_yaml(model: type[M], name: str | Path, text: str | bytes) -> M:
    """Returns the settings in a YAML text.

    Args:
        model: the kind of settings.
        name: name of the file, for errors.
        text: content of the file; bytes are UTF-8.

    Raises:
        ConfigError: the text is not YAML, or a setting is unknown or out of range.
    """
    try:
        tree = yaml.safe_load(text if isinstance(text, str) else untrusted.decode(text))
    except yaml.MarkedYAMLError as error:
        where = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ConfigError(f"{name}: is not a readable YAML file ({where}{error.problem or error.context})") from error
    except Exception as error:  # PyYAML lets through what making numbers, dates and keys raises
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise ConfigError(f"{name}: is not a readable YAML file ({first})") from error
    if tree is None:
        tree = {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{name}: must hold settings in the form 'section: {{key: value}}'")
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{name}: {_explain(error, model)}") from error


def _explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Returns the first fault of a settings tree in one line, with the nearest known name for an unknown one."""
    faults = error.errors()
    gone = [name for f in faults if f["type"] == "extra_forbidden" for name in _list_gone(f["loc"], f["input"])]
    if gone:
        return _explain_gone(gone)
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])  # an unknown name explains a missing one
    where = ".".join(str(part) for part in fault["loc"])
    if fault["type"] != "extra_forbidden":
        return f"{where}: {fault['msg'].removeprefix('Value error, ')}"  # pydantic's prefix of what our own checks raise
    return f"unknown setting {where}; {suggest(str(fault['loc'][-1]), _list_settings(model, fault['loc'][:-1]))}"


def _list_gone(loc: tuple[int | str, ...], value: object) -> list[str]:
    """Returns the names of the settings of former versions, which are constants now, that an unknown key states.

    Args:
        loc: the key, after those of the sections that it is in.
        value: what the file says of it.
    """
    if len(loc) == 2:
        section, name = map(str, loc)
        return [f"{section}.{name}"] if name in _GONE.get(section, "").split() else []
    section = str(loc[0])
    if len(loc) > 1 or section not in _GONE:
        return []
    names = [name for name in _GONE[section].split() if isinstance(value, dict) and name in value]
    return [f"{section}.{name}" for name in names] or [section]


def _explain_gone(names: list[str]) -> str:
    """Returns why settings of a former version are refused."""
    others = f" and {len(names) - _NAMED} others" if len(names) > _NAMED else ""
    are, they = ("is", "it") if len(names) == 1 else ("are", "them")
    listed = ", ".join(names[:_NAMED])
    return f"{listed}{others} {are} no setting any more, but fixed: nobody had a reason to change {they}; leave {they} out"


def _list_settings(model: type[BaseModel], parents: tuple[int | str, ...]) -> list[str]:
    """Returns the names of the settings below some parents; a number among the parents is a place in a list."""
    node: Any = model
    for parent in parents:
        node = get_args(node)[0] if isinstance(parent, int) else node.model_fields[parent].annotation
    return list(node.model_fields)
