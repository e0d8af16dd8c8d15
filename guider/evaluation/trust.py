"""Scores on held-out episodes in plain words: what each says, and whether one would trust the policy."""

from __future__ import annotations

from collections.abc import Mapping

LEAST_SUCCESS, MOST_LEFT, MOST_MODEL_ERROR = 0.8, 0.1, 0.5
LEAST_COVERAGE, LEAST_IN_RANGE = 0.8, 0.9

MEANINGS: Mapping[str, str] = {
    "imagined_success": "share of goals met in a model of the robot learned from the logs, on unseen starts and ends",
    "imagined_steps": "steps that takes (median)",
    "imagined_left_data": "share that strayed to places nothing was logged near, and counts as failed",
    "model_error": "that model's error over c steps, as a share of the way they go; above 0.5 it says little",
    "fitted_value": "worth by fitted Q evaluation, to compare policies by: 0.97 to the power of the steps to the goal",
    "action_error": "squared error of actions towards the state c steps on (bounds are -1 and 1); not success",
    "action_spread": "the same of always answering with the mean action",
    "prior_coverage": "share of true c-step outcomes the prior holds for likely; 0.95 if it fits",
    "prior_coverage_shuffled": "the same of outcomes from elsewhere; should be lower",
    "subgoal_distance": "from proposed subgoals to the nearest logged place (median, goal units)",
    "subgoals_in_range": "share of proposed subgoals no further off than c steps went in the logs",
    "value_rank": "whether what is proposed is worth more, the later in an episode; 1 if always",
}
"""What a score says, where it is shown."""


def verdict(scores: Mapping[str, float | None]) -> str:
    """Whether one would let the policy move the robot, and why not."""
    if (error := scores["model_error"]) is None or error > MOST_MODEL_ERROR:
        return "cannot tell: the model of the robot is too coarse to judge by; try it slowly, a hand on the stop"
    against = []
    if (success := scores["imagined_success"] or 0.0) < LEAST_SUCCESS:
        against.append(f"meets only {success:.0%} of the goals in imagination")
    if (left := scores["imagined_left_data"] or 0.0) > MOST_LEFT:
        against.append(f"strays from the data in {left:.0%} of the episodes")
    if (covered := scores.get("prior_coverage")) is not None and covered < LEAST_COVERAGE:
        against.append(f"has not seen moves like {1 - covered:.0%} of the unseen ones")
    if (near := scores.get("subgoals_in_range")) is not None and near < LEAST_IN_RANGE:
        against.append(f"proposes {1 - near:.0%} of its subgoals too far off")
    if against:
        return f"would not trust it: it {'; it '.join(against)}"
    return "would trust it with a first slow try: in imagination it meets its goals, on the data"
