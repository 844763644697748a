"""Tables as Markdown."""

import pytest

from stages.reporting.tables import in_markdown


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("a|b", "a\\|b"),
        ("a\\|b", "a\\\\\\|b"),
        ("![x](http://y)", "![x]\\(http://y)"),
        ("a\n# b", "a # b"),
        ("a\x1b[2J\u202eb", "a\\\\u001b[2J\\\\u202eb"),
        ("<b>", "&lt;b&gt;"),
    ],
)
def test_no_text_breaks_out_of_its_cell_in_markdown(text, escaped):
    assert in_markdown(text) == escaped
