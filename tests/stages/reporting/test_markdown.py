"""The report as Markdown, line by line."""

from pathlib import Path
from types import SimpleNamespace

from stages.reporting.page import CAPTIONS, CRITERIA, markdown
from stages.reporting.tables import Table, summary_table
from stages.reporting.videos import Video

RUN = """\
<!-- made by ifo report -->

# A | title

From x.h5

| task | method | runs |
| --- | --- | ---: |
| reach | a\\|b | 3 |

{criterion}

## Success by task and method

{success}

![Success by task and method](<page-success.png>)

## Learning curves

{curves}

![Learning curves](<my page-curves.png>)

## Videos

- reach: Learned policies: /x/a.mp4
- push: A \\| B: /x/b.mp4

## Notes

- One &lt;note&gt;
- Another
"""


def test_the_report_as_markdown():
    table = Table(("task", "method", "runs"), [("reach", "a|b", "3")])
    plots = {"success": Path("/x/page-success.png"), "curves": Path("/x/my page-curves.png")}
    videos = [
        Video("reach", "Learned policies", Path("/x/a.mp4"), b""),
        Video("push", "A | B", Path("/x/b.mp4"), b""),
    ]
    text = markdown("A | title", "From x.h5", {"success": table}, plots, videos, ["One <note>", "Another"])
    expected = RUN.format(criterion=CRITERIA["success"], success=CAPTIONS["success"], curves=CAPTIONS["curves"])
    assert text == expected.replace("# A | title", "# A \\| title")
    short = markdown("T", "O", {"success": table}, {}, [], [])
    assert short.endswith(f"| 3 |\n\n{CRITERIA['success']}\n") and "##" not in short


def test_a_row_of_the_summary_table():
    item = SimpleNamespace(
        task="reach", method="translation", runs=[1, 2, 3], success=2 / 3, success_interval=(0.2, 0.94), paper=0.85,
        deterministic=0.126, distance=0.25, distance_interval=(0.1, 0.4), samples=123456.7, learning_minutes=1.26,
        translator_minutes=12.6,
    )  # fmt: skip
    table = summary_table(
        [item, SimpleNamespace(**{**vars(item), "runs": [1], "paper": None, "translator_minutes": None})]
    )
    assert table.rows[0] == (
        "reach", "translation", "3", "0.67 [0.20, 0.94]", "0.85", "0.13", "0.250 [0.100, 0.400]", "123,457", "1.3", "13"
    )  # fmt: skip
    assert table.rows[1][2:] == (
        "1",
        "0.67 [0.20, 0.94]",
        "\N{EN DASH}",
        "0.13",
        "0.250",
        "123,457",
        "1.3",
        "\N{EN DASH}",
    )
    assert set(table.heads[:2]) <= set(table.words) and len(table.heads) == 10
