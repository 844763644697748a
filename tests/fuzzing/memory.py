"""Where the files of targets go. Nothing of ifo is imported here: atheris must see these imports."""

from pathlib import Path

IN_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
PREFIX = "ifo-fuzz-"
GIVEN = "IFO_FUZZ_PLACE"  # environment variable: the folder of a process that may end without its clean-up
