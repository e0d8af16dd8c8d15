"""The numbers the paper prints, as it prints them: (mean, standard deviation) over 4 seeds, or None where it has none.

Scores are in the tasks' own units, see guider.tasks.types.Score. Figures 3 to 7 come without numbers; what stands
beside our curves and bars are Table 1's and Table 2's, which they are drawn from.
"""

from __future__ import annotations

from typing import Literal

TargetName = Literal["table1", "table2", "table3", "figure3", "figure4", "figure5", "figure6", "figure7"]
"""What can be made."""

PaperScore = tuple[float, float | None] | None

TABLE_1_METHODS: tuple[str, ...] = ("opal", "gcsl", "wgcsl", "cql-her", "guider")
# Antmaze and kitchen scores of OPAL are those of Ajay et al. 2021, which the paper repeats.
TABLE_1: dict[str, tuple[PaperScore, ...]] = {
    "antmaze-umaze-diverse": (None, (49.5, 5.9), (79.5, 2.3), (60.7, 7.6), (88.5, 4.4)),
    "antmaze-medium-diverse": ((81.1, 3.1), (45.3, 13.7), (54.0, 8.8), (28.3, 5.3), (87.3, 0.4)),
    "antmaze-large-diverse": ((70.3, 2.9), (11.8, 3.6), (17.5, 6.7), (11.3, 8.2), (80.8, 4.6)),
    "fetch-reach-expert": ((46.0, 0.1), (39.8, 0.4), (46.3, 0.2), (47.3, 0.2), (48.0, 0.1)),
    "fetch-push-expert": ((18.9, 0.4), (32.8, 1.6), (38.9, 0.4), (38.5, 1.2), (39.9, 1.0)),
    "fetch-slide-expert": ((0.7, 0.1), (4.4, 1.4), (10.6, 0.9), (3.9, 1.7), (7.6, 0.3)),
    "fetch-pick-expert": ((24.2, 2.6), (27.2, 0.5), (36.1, 0.5), (36.9, 2.3), (40.9, 0.6)),
    "fetch-reach-mixed": ((45.2, 0.2), (34.5, 1.0), (46.7, 0.2), (46.6, 0.5), (47.0, 0.2)),
    "fetch-push-mixed": ((5.5, 2.5), (6.1, 2.1), (30.8, 3.2), (21.8, 3.8), (33.4, 2.3)),
    "fetch-slide-mixed": ((0.7, 0.2), (1.9, 0.7), (5.6, 1.0), (3.7, 1.2), (4.1, 0.6)),
    "fetch-pick-mixed": ((5.9, 3.0), (12.0, 3.5), (22.9, 5.9), (25.8, 6.9), (33.2, 2.4)),
    "kitchen-complete": (None, (58.6, 8.7), (57.7, 4.7), (33.3, 5.7), (68.8, 7.2)),
    "kitchen-partial": ((65.2, 2.5), (55.0, 14.5), (59.4, 13.3), (26.3, 4.5), (70.4, 7.8)),
    "kitchen-mixed": ((64.6, 1.8), (56.2, 5.4), (49.6, 2.9), (23.5, 1.1), (67.1, 5.8)),
}


def from_table_1(task: str, method: str) -> PaperScore:
    """What Table 1 prints for it; None for methods that it has not."""
    return dict(zip(TABLE_1_METHODS, TABLE_1[task], strict=True)).get(method)


# Guider, without the prior, without CQL.
TABLE_2: dict[str, tuple[PaperScore, ...]] = {
    "antmaze-large-diverse": ((80.8, 4.6), (57.0, 11.3), (78.5, 11.4)),
    "fetch-pick-mixed": ((33.2, 2.4), (20.2, 5.0), (28.8, 0.9)),
    "kitchen-partial": ((70.4, 7.8), (38.9, 16.2), (59.7, 10.2)),
}

TABLE_3_PERIODS = (25, 50, 75, 100)
# Means alone.
TABLE_3: dict[str, tuple[PaperScore, ...]] = {
    "antmaze-large-diverse": ((77.5, None), (80.8, None), (79.3, None), (73.8, None)),
    "antmaze-medium-diverse": ((83.3, None), (87.3, None), (85.0, None), (81.5, None)),
}
