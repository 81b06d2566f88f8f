"""Pages that are made from the code say what the code says."""

from pathlib import Path

import pytest

from fault.fmea_page import fmea_page

DOCS = Path(__file__).resolve().parents[1] / "docs"


@pytest.mark.requirement("WB-FLT-12")
def test_the_page_of_failures_is_that_of_the_list() -> None:
    assert (DOCS / "fmea.md").read_text(encoding="utf-8") == fmea_page(), "write fault.fmea_page.fmea_page() there"
