"""results/faults.md is made of sections, each by its own command, and lists faults with tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

from tests.faults.table import SECTIONS, found, read_sections, write_section

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "results" / "faults.md"


def test_each_command_replaces_its_own_section(tmp_path):
    page = tmp_path / "faults.md"
    write_section(page, "Fuzzing", "first\n\n| a |")
    write_section(page, "Injections", "5 injections, 0 failed.")
    write_section(page, "Fuzzing", "second")
    sections = read_sections(page)
    assert tuple(sections) == SECTIONS
    assert sections["Fuzzing"] == "second" and sections["Injections"] == "5 injections, 0 failed."


def test_every_fault_that_was_found_has_a_test():
    assert len({one["fault"] for one in found()}) == len(found()) > 40
    for one in found():
        path, _, name = one["test"].partition("::")
        assert re.search(rf"^def {name}\(", (ROOT / path).read_text(), re.M), one["test"]
        assert "|" not in one["fault"]
