"""What is to be learned, whatever the method."""

from __future__ import annotations

from dataclasses import dataclass

from guider.goals import Parts
from guider.support.config import check_positive


@dataclass(frozen=True)
class Problem:
    """What a task, or the owner of the data, settles before any method is chosen."""

    radius: float = 0.5
    """A goal or subgoal is met, and rewarded, within this distance (Eq. 1's epsilon, goal units)."""
    reach_radius: float = 1.0
    """Acting: a subgoal counts as reached within this distance (goal units)."""
    period_steps: int = 50
    """c: environment steps between subgoals."""
    goal_parts: Parts = ()
    """Entries of the goal that must each be within the radius (kitchen: one part per object); () is all as one part."""
    domain: str | None = None
    """Of the task, None for one's own data: presets differ between domains."""
    goal_dim: int | None = None
    """Of one's own data: entries of the goal space. Tasks leave it out, and so are what they were when they were
    measured."""
    transitions: int | None = None
    """Of one's own data, likewise: how many there are to learn from."""
    window_move: float = 0.0
    """Of one's own data: how far a window of c steps goes at least that says what is reachable (goal units)."""

    def __post_init__(self) -> None:
        check_positive(self, "period_steps", "radius", "reach_radius")
