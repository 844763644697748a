"""Copy pip's settings to another root folder, so that pip finds packages there as on this machine.

The script reads the output of `pip config list` from standard input and writes ROOT/etc/pip.conf. It prints the files
and folders that the settings name, one per line: the same paths must exist in ROOT.

    pip config list | python3 .ci/pip_settings.py ROOT
"""

from __future__ import annotations

import ast
import configparser
import sys
from pathlib import Path

# Settings for the sources and the download of packages. Other settings (a cache, a log) apply only to this machine.
INDEXES = ("index-url", "extra-index-url")
KEPT = (
    *INDEXES,
    "cert",
    "client-cert",
    "constraint",
    "default-timeout",
    "find-links",
    "no-index",
    "proxy",
    "retries",
    "timeout",
    "trusted-host",
)


def parse(lines: list[str]) -> dict[str, dict[str, str]]:
    """Return settings by section; settings from the environment are global and override those from files."""
    sections: dict[str, dict[str, str]] = {}
    for line in sorted(lines, key=lambda line: line.startswith(":env:")):
        name, equals, value = line.partition("=")
        section, _, key = name.rpartition(".")
        if equals and key in KEPT:
            sections.setdefault("global" if section == ":env:" else section, {})[key] = ast.literal_eval(value)
    return sections


def named_paths(sections: dict[str, dict[str, str]]) -> list[str]:
    """Return the files and folders of this machine that the settings name."""
    found = set()
    for settings in sections.values():
        for key, value in settings.items():
            for word in value.split():
                path = Path(word.removeprefix("file://"))
                if key in INDEXES:
                    path = path.parent  # The files of an index are usually next to its list of projects.
                if path.is_absolute() and path.exists() and path != Path(path.anchor):
                    found.add(str(path))
    return sorted(found)


def main(root: Path) -> None:
    sections = parse(sys.stdin.read().splitlines())
    conf = configparser.RawConfigParser()
    conf.read_dict(sections)
    with (root / "etc" / "pip.conf").open("w") as file:
        conf.write(file)
    print(*named_paths(sections), sep="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
