"""Of what is told of scores. See `mutants.table`."""

from mutants.mutation import Table

_REPORTED = "reproduce/test_report.py::test_the_table_says_mean_and_deviation_beside_the_papers"
_PROTOCOL = "reproduce/test_report.py::test_the_protocol_is_stated"

TABLE: Table = {
    "guider/reproduce/scores.py": [
        ('["horizon_steps"] if counts_steps else 100', '["horizon_steps"]', _REPORTED),
        ("== SCORE_UNITS", "!= SCORE_UNITS", _REPORTED),
        (
            "float(probability_of_improvement(guider, ours))",
            "float(probability_of_improvement(ours, guider))",
            _REPORTED,
        ),
        ("np.array(cell.paper[0])", "cell.scores", _REPORTED),
        ("interquartile_mean(ours)),", "ours.mean()),", _REPORTED),
        ('"metrics.jsonl")) / 60', '"metrics.jsonl"))', _PROTOCOL),
        ("if all(d.get(name, ...) == value", "if any(d.get(name, ...) == value", _PROTOCOL),
        ("asked.first_seed + asked.seeds - 1", "asked.first_seed + asked.seeds", _PROTOCOL),
    ],
    "guider/reproduce/report.py": [
        ("{cell['mean']:.1f}** ± {cell['deviation']:.1f}", "{cell['deviation']:.1f}** ± {cell['mean']:.1f}", _REPORTED),
    ],
}
