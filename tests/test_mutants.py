"""The table of mutations fits the code as it is: whoever changes a line that is mutated changes the mutation too."""

from pathlib import Path

from mutants.__main__ import ROOT, stale
from mutants.table import MUTATIONS


def test_every_text_to_replace_stands_once():
    assert [str(mutation) for mutation in MUTATIONS if stale(mutation)] == []


def test_every_test_that_is_to_notice_is_there():
    missing = []
    for test in sorted({test for mutation in MUTATIONS for test in mutation.tests.split()}):
        file, _, function = test.partition("::")
        path = Path(ROOT, "tests", file)
        if not path.is_file() or f"def {function.partition('[')[0]}" not in path.read_text():
            missing.append(test)
    assert missing == []
