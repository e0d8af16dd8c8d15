"""OGBench's published success rates, %: means over eight seeds and the last three evaluations of a million updates
(Park et al. 2025), and the best that others have published since, as far as we know."""

from __future__ import annotations

METHODS = ("GCBC", "GCIVL", "GCIQL", "QRL", "CRL", "HIQL", "best since")
OGBENCH = {
    "pointmaze-medium-navigate": ("9", "63", "53", "82", "29", "79", "SAW 97"),
    "pointmaze-large-navigate": ("29", "45", "34", "86", "39", "58", "QRL 86"),
    "pointmaze-giant-navigate": ("1", "0", "0", "68", "27", "46", "S2AW 73"),
    "pointmaze-medium-stitch": ("23", "70", "21", "80", "0", "74", "CompDiffuser 100"),
    "pointmaze-large-stitch": ("7", "12", "31", "84", "0", "13", "CompDiffuser 100"),
    "pointmaze-giant-stitch": ("0", "0", "0", "50", "0", "0", "GCIQL + TTGS 98"),
    "antmaze-giant-navigate": ("0", "0", "0", "14", "16", "65", "S2AW 87"),
    "antmaze-giant-stitch": ("0", "0", "0", "0", "0", "2", "GAS 88"),
    "cube-single-play": ("6", "53", "68", "5", "19", "15", "S2AW 86"),
    "cube-double-play": ("1", "36", "40", "1", "10", "6", "S2AW 57"),
    "scene-play": ("5", "42", "51", "5", "19", "38", "ORS 80"),
    "puzzle-3x3-play": ("2", "6", "95", "1", "3", "12", "GCIQL 95"),
}
"""Data set -> what METHODS reach on it."""
