"""Makes results/footage.md: media files of many kinds, and whether the import shows what they contain.

    python results/footage.py

The files are made in a temporary folder. The independent decode is the command `ffmpeg`, or PyAV where there is none.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))  # The tests are no part of the package.

from tests.stages.footage.catalog import MEDIA  # noqa: E402
from tests.stages.footage.comparison import as_markdown, measure  # noqa: E402


def main() -> None:
    """Measure all files and write the table."""
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(media, Path(folder)) for media in MEDIA.values()]
    table = f"<!-- made by results/footage.py -->\n{as_markdown(rows)}"
    (HERE / "footage.md").write_text(table, encoding="utf-8")
    print(HERE / "footage.md")
    sys.exit(any(row.wrong for row in rows))


if __name__ == "__main__":
    main()
