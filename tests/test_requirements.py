"""docs/requirements.md and the tests say the same: every requirement has its tests, every marker its requirement."""

import ast
import re
from collections import defaultdict
from pathlib import Path

TESTS = Path(__file__).parent
PAGE = TESTS.parent / "docs" / "requirements.md"
ROW = re.compile(r"^\| (WB-[A-Z]{3}-\d{2}) \| (.+?) \| (.+?) \| (.+?) \|$")


def requirements() -> dict[str, tuple[str, str, set[str]]]:
    """Text, rationale and tests of each requirement on the page, by number."""
    rows = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if found := ROW.match(line):
            number, text, rationale, tests = found.groups()
            assert number not in rows, f"{number} stands on the page twice"
            rows[number] = text, rationale, set(re.findall(r"`(test_\w+)`", tests))
    return rows


def marked() -> dict[str, set[str]]:
    """Tests that carry each number."""
    numbers: dict[str, set[str]] = defaultdict(set)
    for path in sorted(TESTS.glob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name.lower().startswith("test"):
                for number in _numbers(node):
                    numbers[number].add(node.name)
    return numbers


def _numbers(node: ast.FunctionDef | ast.ClassDef) -> list[str]:
    return [
        argument.value
        for mark in node.decorator_list
        if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.requirement"
        for argument in mark.args
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
    ]


def test_every_requirement_has_a_test_and_every_marker_a_requirement() -> None:
    on_page, in_tests = requirements(), marked()
    assert len(on_page) >= 60
    assert sorted(on_page.keys() - in_tests.keys()) == [], "requirements without a test"
    assert sorted(in_tests.keys() - on_page.keys()) == [], "markers without a requirement"


def test_the_page_names_exactly_the_tests_that_carry_the_number() -> None:
    in_tests = marked()
    differing = {number: tests ^ in_tests[number] for number, (_, _, tests) in requirements().items()}
    assert {number: names for number, names in differing.items() if names} == {}
